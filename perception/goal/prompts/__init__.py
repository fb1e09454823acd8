"""The prompts of stage 1, one text file a step; ``{fields}`` are placeholders."""

from __future__ import annotations

from importlib.resources import files


def prompt(step: str, **fields: str) -> str:
    """Return the prompt of one step with its placeholders filled in. Raises: KeyError for a missing field."""
    return files(__name__).joinpath(f"{step}.txt").read_text().format(**fields)
