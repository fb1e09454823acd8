"""The amount of planning that a pick may take, in collision checks: the same inputs give the same plan everywhere."""

from __future__ import annotations

from planning.world import Effort

CHECK_S = 6e-5
"""The cost of a checked configuration, with all that is planned beside it: CPU time, the middle of 38 plans in heaps
of 12, where it lies between 40 and 118 us."""


class Budget:
    """Compares the checks since the beginning with what is allowed. ``budget_s``: in seconds, at `CHECK_S` each."""

    def __init__(self, budget_s: float) -> None:
        self._most = budget_s / CHECK_S
        self._watched: list[tuple[Effort, int]] = []

    def watch(self, effort: Effort) -> None:
        """Count what is done in a scene from now on, too."""
        if all(effort is not known for known, _ in self._watched):
            self._watched.append((effort, effort.checks))

    @property
    def is_over(self) -> bool:
        """Whether more was done than is allowed."""
        return sum(effort.checks - before for effort, before in self._watched) > self._most
