"""The tally of an intruder's tries."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

_KEPT_CASES = 40


@dataclass
class Tally:
    """Counts; ``cases``: what crashed, in words."""

    by_kind: Counter[str] = field(default_factory=Counter)
    by_code: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    picks: Counter[str] = field(default_factory=Counter)
    moved: int = 0
    crashes: int = 0
    cases: list[str] = field(default_factory=list)

    def accept(self, kind: str, what: str) -> None:
        """An act was carried out, or a lie was believed."""
        self.accepted[f"{kind}: {what}"] += 1

    def crash(self, text: str) -> None:
        """Something is not there any more, or no longer answers."""
        self.crashes += 1
        if len(self.cases) < _KEPT_CASES:
            self.cases.append(text)

    def figures(self) -> dict[str, object]:
        """As JSON has it; ``accepted`` and its like are to be 0."""
        return {
            "tries": sum(self.by_kind.values()),
            "accepted": sum(self.accepted.values()),
            "picks": dict(self.picks),
            "moved": self.moved,
            "crashes": self.crashes,
            "by_kind": dict(self.by_kind),
            "by_code": dict(self.by_code),
            "accepted_kinds": dict(self.accepted),
            "crash_cases": self.cases,
        }
