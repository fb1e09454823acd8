"""The cost of hosted models and its limits. The cost of the day survives a restart, because it is in the ledger."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, date, datetime
from pathlib import Path

from bus.codes import Code
from bus.errors import CycleFailure
from config.perception import HostedSettings
from perception.models.ledger import Ledger

LEDGER = "spend.jsonl"


def utc_now() -> datetime:
    """Return the time now, UTC."""
    return datetime.now(UTC)


class Budget:
    """Records costs, and refuses further calls once a limit is reached. Thread-safe.

    Args:
        ledger: file of the costs (`Ledger`); created when first needed.
        now: UTC clock.

    Attributes:
        cycle: number of cycles so far. A call is charged to the cycle in which it began, however late its answer comes.

    Raises: RecordingError when the ledger cannot be read.
    """

    def __init__(self, settings: HostedSettings, ledger: Path, now: Callable[[], datetime] = utc_now) -> None:
        self.now = now
        self._settings, self._ledger = settings, Ledger(ledger)
        self._turn = threading.Lock()
        self.cycle = 0
        self._cycle_usd = 0.0
        self._day = now().date()
        self._day_usd = self._ledger.spent_on(self._day)

    def begin(self) -> None:
        """Begin a cycle."""
        with self._turn:
            self.cycle += 1
            self._cycle_usd = 0.0

    def require(self) -> None:
        """Refuse when a limit is reached. Raises: CycleFailure(SPEND_LIMIT), for this cycle's or this day's limit."""
        with self._turn:
            self._turn_page(self.now().date())
            cycle = (self._cycle_usd, self._settings.max_cycle_usd, "this cycle")
            day = (self._day_usd, self._settings.max_day_usd, "today (UTC)")
        for spent, limit, where in (cycle, day):
            if spent >= limit:
                raise CycleFailure(
                    Code.SPEND_LIMIT, f"Hosted models have cost {spent:.2f} USD {where}; {limit:.2f} are allowed."
                )

    def pay(self, model: str, usd: float, cycle: int | None = None, began: datetime | None = None) -> None:
        """Record the cost [USD] of a call in the cycle and on the day it began in (None = this cycle, now).

        Raises: RecordingError when the ledger cannot be written.
        """
        at = began or self.now()
        with self._turn:
            self._turn_page(self.now().date())
            if cycle in (None, self.cycle):
                self._cycle_usd += usd
            if at.date() == self._day:
                self._day_usd += usd
            if usd > 0:
                self._ledger.note(at, model, usd)

    def _turn_page(self, today: date) -> None:
        if today != self._day:
            self._day, self._day_usd = today, 0.0
