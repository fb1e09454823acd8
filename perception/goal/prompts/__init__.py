"""The prompts of the imagining, one text file a step; ``{fields}`` are filled in."""

from __future__ import annotations

from importlib.resources import files


def prompt(step: str, **fields: str) -> str:
    """The text of one step with its fields filled in; a missing or unknown field is a KeyError."""
    return files(__name__).joinpath(f"{step}.txt").read_text().format(**fields)
