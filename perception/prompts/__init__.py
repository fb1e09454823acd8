"""The prompts of the imagining, one text file a step; ``{fields}`` are filled in. Version 1."""

from __future__ import annotations

from importlib.resources import files

VERSION = 1


def prompt(step: str, **fields: str) -> str:
    """The text of ``reason``, ``direct`` or ``constraint`` with its fields filled in."""
    return files(__name__).joinpath(f"{step}.txt").read_text().format(**fields)
