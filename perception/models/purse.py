"""What hosted models cost, and the limits on it. The day's spending survives a restart: it is a file of lines."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from bus.codes import Code
from bus.errors import CycleFailure, RecordingError
from config.schema import HostedSettings

LEDGER = "spend.jsonl"


def utc_now() -> datetime:
    return datetime.now(UTC)


class Purse:
    """Pays for calls, and refuses before the next one once a limit is reached.

    Args:
        ledger: one JSON object a line: ``{"at", "model", "usd"}``; made when first needed.
        now: UTC clock.

    Raises: RecordingError when the ledger cannot be read.
    """

    def __init__(self, settings: HostedSettings, ledger: Path, now: Callable[[], datetime] = utc_now) -> None:
        self._settings, self._ledger, self._now = settings, ledger, now
        self._cycle_usd = 0.0
        self._day = now().date()
        self._day_usd = self._spent_today()

    def begin(self) -> None:
        """A new cycle."""
        self._cycle_usd = 0.0

    def require(self) -> None:
        """Raises: CycleFailure(SPEND_LIMIT) when this cycle or this day has spent what it may."""
        if self._now().date() != self._day:
            self._day, self._day_usd = self._now().date(), 0.0
        for spent, limit, where in (
            (self._cycle_usd, self._settings.max_cycle_usd, "this cycle"),
            (self._day_usd, self._settings.max_day_usd, "today (UTC)"),
        ):
            if spent >= limit:
                raise CycleFailure(
                    Code.SPEND_LIMIT, f"Hosted models have cost {spent:.2f} USD {where}; {limit:.2f} are allowed."
                )

    def pay(self, model: str, usd: float) -> None:
        """Note what a call cost. Raises: RecordingError when it cannot be written."""
        self._cycle_usd += usd
        self._day_usd += usd
        if usd == 0:
            return
        line = json.dumps({"at": self._now().isoformat(timespec="seconds"), "model": model, "usd": round(usd, 6)})
        try:
            self._ledger.parent.mkdir(parents=True, exist_ok=True)
            with self._ledger.open("a") as file:
                file.write(line + "\n")
        except OSError as error:
            raise RecordingError(
                f"Cannot note spending in {self._ledger}: {error.strerror}.", "Free the folder."
            ) from error

    def _spent_today(self) -> float:
        if not self._ledger.exists():
            return 0.0
        try:
            entries = [json.loads(line) for line in self._ledger.read_text().splitlines() if line.strip()]
            return float(sum(entry["usd"] for entry in entries if entry["at"].startswith(self._day.isoformat())))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RecordingError(
                f"The spending ledger {self._ledger} cannot be read ({error}).", "Correct it or move it away."
            ) from error
