"""One row a cycle, derived from the recordings: lists, sums and queries without reading them."""

from logs.catalogue.catalogue import Catalogue, known_entries, open_catalogue
from logs.catalogue.figures import Summary, summary

__all__ = ["Catalogue", "Summary", "known_entries", "open_catalogue", "summary"]
