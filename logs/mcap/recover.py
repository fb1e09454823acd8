"""Recovers torn or damaged recordings: writes the records that `logs.mcap.torn_reader` reads into a finished file."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from bus.atomic import written_atomically
from bus.codec import Json
from bus.errors import RecordingError
from logs.mcap.names import found_below, is_folder, shown
from logs.mcap.reader import RECOVERED
from logs.mcap.recorder import PART
from logs.mcap.torn_reader import Losses, TornReader
from logs.mcap.writer import McapFile

_MAX_CHANNELS = (1 << 16) - 1
_INTERRUPTED = {
    "result": "INTERRUPTED",
    "code": "",
    "reason": "The recording ends in the middle of the cycle: its process was killed, or its disk full.",
}


@dataclass(frozen=True)
class Recovered:
    """The outcome for one file.

    Attributes:
        source, path: the file, and the recovered one.
        messages: number of messages kept. ``losses``: the parts left out.
        ended: state of the file's end: ``finished``, or ``torn`` as a killed process leaves it.
    """

    source: str
    path: str
    messages: int
    losses: Losses
    ended: str

    @property
    def lost(self) -> bool:
        """True when written data is missing, other than the part that was never flushed."""
        was_finished_once = not self.source.endswith(PART)
        return bool(self.losses) or (was_finished_once and self.ended == "torn")

    def to_json(self) -> Json:
        """Return the fields as a JSON object, the losses merged into it."""
        said = asdict(self)
        losses = said.pop("losses")
        lost_chunks = losses.pop("damaged")
        return {**said, "lost_chunks": lost_chunks, **losses, "lost": self.lost}

    def line(self) -> str:
        """One line for a person."""
        lost = f", {self.losses} lost" if self.losses else ", its end lost" if self.lost else ""
        source, path = shown(Path(self.source)), shown(Path(self.path))
        return f"{source} was {self.ended}: {self.messages} messages kept{lost}, in {path}"


def recover(path: Path) -> Recovered:
    """Write the content of ``path`` into a finished file beside it. A ``.part`` gets its final name and is removed.

    For any other file the result is ``NAME.recovered.mcap``; the file, and a ``.part`` with damage inside, are kept.

    Raises: RecordingError when there is nothing to recover, or the file is still being written (`StillWritten`).
    """
    try:
        target = _target(path)
        with path.open("rb") as source:
            _require_left(source, path)
            done = _copy(source, path, target)
        if path.name.endswith(PART) and not done.lost:
            path.unlink()
    except OSError as error:
        raise RecordingError(
            f"Cannot recover {shown(path)}: {error.strerror or error}.", "Check the disk's space and rights."
        ) from error
    return done


def recover_leftovers(folder: Path) -> Iterator[Recovered | RecordingError]:
    """Recover every ``.part`` below ``folder`` that is not being written; failures are yielded as errors."""
    for path in found_below(folder, f"*.mcap{PART}") if is_folder(folder) else ():
        try:
            yield recover(path)
        except StillWritten:
            continue
        except RecordingError as error:
            yield error


class StillWritten(RecordingError):
    """The file is still being written by a live process."""


def _target(path: Path) -> Path:
    if not path.is_file():
        raise RecordingError(f"There is no recording {shown(path)}.", "See `cell cycles`.")
    name = path.name.removesuffix(PART) if path.name.endswith(PART) else f"{path.stem}.recovered.mcap"
    target = path.with_name(name)
    if target.exists():
        raise RecordingError(f"{shown(target)} is already there.", f"Move it away if {shown(path)} holds more.")
    return target


def _require_left(source: IO[bytes], path: Path) -> None:
    try:
        fcntl.flock(source, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise StillWritten(f"{shown(path)} is being written.", "Wait until its cycle is over.") from error


# --- copying ----------------------------------------------------------------------------------------------------------


def _copy(source: IO[bytes], path: Path, target: Path) -> Recovered:
    """Copy into a file that gets its name when it is complete, and the torn one's mode."""
    torn = TornReader(source)
    with written_atomically(target, mode=path.stat().st_mode & 0o777) as out:
        writer = _Copy(McapFile(out))
        for record in torn.records():
            writer.add(record)
        if not writer.messages and not writer.is_ours:
            lost = f": {torn.losses}" if torn.losses else ""
            raise RecordingError(
                f"{shown(path)} holds nothing that can be recovered{lost}.",
                "It is no MCAP, or was torn before its first flush.",
            )
        torn.losses.orphans = writer.orphans
        ended = "finished" if torn.is_finished else "torn"
        writer.finish(shown(Path(path.name)), ended, torn.losses)
    return Recovered(str(path), str(target), writer.messages, torn.losses, ended)


class _Copy:
    """Writes records unchanged, under ids of its own."""

    def __init__(self, out: McapFile) -> None:
        self._out = out
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._has_result = False
        self.messages = self.orphans = 0
        self.is_ours = False

    def add(self, record: McapRecord) -> None:
        match record:
            case Schema() if record.id not in self._schemas:
                self._schemas[record.id] = self._out.schema(record.name, record.encoding, record.data)
            case Channel() if record.id not in self._channels and len(self._channels) < _MAX_CHANNELS:
                schema_id = self._schemas.get(record.schema_id, 0)  # 0 = no schema; a lost schema loses no message
                self._channels[record.id] = self._out.channel(record.topic, record.message_encoding, schema_id)
            case Message() if record.channel_id not in self._channels:
                self.orphans += 1
            case Message():
                channel_id = self._channels[record.channel_id]
                self._out.message(channel_id, record.log_time, record.data, record.publish_time, record.sequence)
                self.messages += 1
            case Attachment():
                self._out.attachment(record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                self.is_ours = self.is_ours or record.name == "run"
                self._has_result = self._has_result or record.name == "result"
                self._out.metadata(record.name, record.metadata)
            case _:
                pass

    def finish(self, source: str, ended: str, losses: Losses) -> None:
        said = {} if self._has_result else _INTERRUPTED
        how = {RECOVERED: "yes", "recovered_from": source, "ended": ended, "lost_chunks": str(losses.damaged)}
        how |= {"lost": str(losses)} if losses else {}
        self._out.metadata("result", {**said, **how})
        self._out.finish()
