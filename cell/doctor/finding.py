"""What one check of the doctor says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from config.schema import Station


class Verdict(StrEnum):
    """``skip``: does not apply to this station, or cannot be told now."""

    OK = "ok"
    FIX = "fix"
    SKIP = "skip"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Attributes:
        name: of what was checked, in an operator's words.
        found: what is so. ``advice``: what to do about it; only of ``fix``.
    """

    name: str
    verdict: Verdict
    found: str
    advice: str = ""

    def to_json(self) -> dict[str, str]:
        return {"name": self.name, "verdict": self.verdict, "found": self.found, "advice": self.advice}


Check = Callable[[Station], Finding]


def ok(name: str, found: str) -> Finding:
    return Finding(name, Verdict.OK, found)


def fix(name: str, found: str, advice: str) -> Finding:
    return Finding(name, Verdict.FIX, found, advice)


def skip(name: str, why: str) -> Finding:
    return Finding(name, Verdict.SKIP, why)


def uses(station: Station, driver: str) -> bool:
    """Whether a node of the station has this driver."""
    return any(node.driver == driver for node in station.nodes.values())
