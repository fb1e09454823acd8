"""The finding of one check of the doctor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from config.schema import Station


class Verdict(StrEnum):
    """The verdict of a check. ``skip``: this station has no such part, or it cannot be decided now."""

    OK = "ok"
    FIX = "fix"
    SKIP = "skip"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Attributes:
        name: of the checked item, in an operator's words.
        found: the observation. ``advice``: what to do about it; only of ``fix``.
        is_needed: False where the station has no such part: then it was not looked at.
    """

    name: str
    verdict: Verdict
    found: str
    advice: str = ""
    is_needed: bool = True

    def to_json(self) -> dict[str, str]:
        """Return the fields as a JSON object."""
        return {"name": self.name, "verdict": self.verdict, "found": self.found, "advice": self.advice}


Check = Callable[[Station], Finding]


def ok(name: str, found: str) -> Finding:
    """Return the finding of a passed check."""
    return Finding(name, Verdict.OK, found)


def fix(name: str, found: str, advice: str) -> Finding:
    """Return the finding of a failed check, with advice."""
    return Finding(name, Verdict.FIX, found, advice)


def skip(name: str, why: str) -> Finding:
    """Return the finding of a check that cannot be decided now."""
    return Finding(name, Verdict.SKIP, why)


def not_needed(name: str, why: str) -> Finding:
    """Return the finding of a check that this station has no use for."""
    return Finding(name, Verdict.SKIP, why, is_needed=False)


def uses(station: Station, driver: str) -> bool:
    """True when a node of the station has this driver."""
    return any(node.driver == driver for node in station.nodes.values())
