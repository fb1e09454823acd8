"""The cost of writing the same messages with our MCAP writer and the libraries': CPU, bytes, losses after a kill.

Every writer gets the same batches and is flushed after each, as a recording is; they take turns, and of its rounds the
cheapest counts, so that what else the machine does falls out of the ratios.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, NamedTuple, Protocol

import foxglove
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from benchmarks.damaged import messages, up_to_damage
from logs.mcap.writer import McapFile

_ROUNDS = 7
_MB = 1e6


class LoggedMessage(NamedTuple):
    """One message as it was recorded."""

    schema: Schema
    channel: Channel
    log_time_ns: int
    payload: bytes


Batch = Sequence[LoggedMessage]
"""Messages written between two flushes."""


class MessageWriter(Protocol):
    """As much of a writer as is measured."""

    def write(self, message: LoggedMessage) -> None: ...
    def flush(self) -> None: ...
    def finish(self) -> None: ...


def compare(traffic: dict[str, list[Batch]], tell: Callable[[str], None]) -> dict[str, Any]:
    """For each kind of traffic and each writer: CPU [ms a MB], bytes [% of the payloads], and both beside ours."""
    figures: dict[str, Any] = {}
    for kind, batches in traffic.items():
        raw = sum(len(message.payload) for batch in batches for message in batch)
        costs = _costs(batches)
        ours_s, ours_bytes, _ = costs["ours"]
        figures[kind] = {"payload_mb": round(raw / _MB, 2), "flushes": len(batches)}
        for name, (cpu_s, written, lost) in costs.items():
            figures[kind][name] = {
                "cpu_ms_per_mb": round(cpu_s * 1e3 / (raw / _MB), 2),
                "size_percent": round(100 * written / raw, 1),
                "cpu_to_ours": round(cpu_s / ours_s, 2),
                "size_to_ours": round(written / ours_bytes, 2),
                "lost_of_flushed": lost,
            }
            tell(f"{kind}, {name}: {figures[kind][name]}")
    return figures


def batches_of(recording: Path) -> list[Batch]:
    """A recording's messages, chunk by chunk: each was closed by a flush, or was full."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    batches: list[Batch] = []
    with recording.open("rb") as file:
        for chunk in StreamReader(file, emit_chunks=True).records:
            batch = []
            for record in breakup_chunk(chunk) if isinstance(chunk, Chunk) else ():
                match record:
                    case Schema():
                        schemas[record.id] = record
                    case Channel():
                        channels[record.id] = record
                    case Message():
                        channel = channels[record.channel_id]
                        batch.append(LoggedMessage(schemas[channel.schema_id], channel, record.log_time, record.data))
            batches += [batch] if batch else []
    return batches


def _costs(batches: Iterable[Batch]) -> dict[str, tuple[float, int, int]]:
    """By writer: CPU time [s], bytes, and messages lost of what was flushed."""
    best: dict[str, tuple[float, int, int]] = {}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "one.mcap"
        for number in range(_ROUNDS):
            for name, open_writer in WRITERS.items():
                with path.open("wb") as file:
                    cpu_s = _written(open_writer(file), batches)
                lost = best[name][2] if number else _lost_of_flushed(open_writer, batches)
                if not number or cpu_s < best[name][0]:
                    best[name] = cpu_s, path.stat().st_size, lost
    return best


def _written(writer: MessageWriter, batches: Iterable[Batch]) -> float:
    """CPU time [s] from the first message to the finished file."""
    cpu_s = time.process_time()
    for batch in batches:
        for message in batch:
            writer.write(message)
        writer.flush()
    writer.finish()
    return time.process_time() - cpu_s


def _lost_of_flushed(open_writer: Callable[[IO[bytes]], MessageWriter], batches: Iterable[Batch]) -> int:
    """Messages that a reader misses in what the operating system had when the last flush was over, and nothing else."""
    with TemporaryDirectory() as folder:
        path, flushed = Path(folder) / "one.mcap", 0
        with path.open("wb") as file:
            writer = open_writer(file)
            for batch in batches:
                for message in batch:
                    writer.write(message)
                writer.flush()
                flushed += len(batch)
            left = path.read_bytes()  # what a kill now would leave
            writer.finish()
    return flushed - messages(up_to_damage(left))


# --- the writers ------------------------------------------------------------------------------------------------------


class _Declared:
    """The ids of what was declared so far, by ``schema`` and ``channel`` of one writer."""

    def __init__(self, schema: Callable[[str, str, bytes], int], channel: Callable[[str, str, int], int]) -> None:
        self._schema, self._channel = schema, channel
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def channel(self, message: LoggedMessage) -> int:
        topic, schema = message.channel.topic, message.schema
        if topic not in self._channels:
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._schema(schema.name, schema.encoding, schema.data)
            encoding = message.channel.message_encoding
            self._channels[topic] = self._channel(topic, encoding, self._schemas[schema.name])
        return self._channels[topic]


class _Ours:
    def __init__(self, file: IO[bytes]) -> None:
        self._out = McapFile(file)
        self._declared = _Declared(self._out.schema, self._out.channel)
        self.flush, self.finish = self._out.flush, self._out.finish

    def write(self, message: LoggedMessage) -> None:
        at_ns = message.log_time_ns
        self._out.message(self._declared.channel(message), at_ns, message.payload, publish_time_ns=at_ns, sequence=0)


class _Mcap:
    """The library of MCAP's authors, with the checksum of the data section, as ours has."""

    def __init__(self, file: IO[bytes], compression: CompressionType) -> None:
        self._out = Writer(file, compression=compression, enable_data_crcs=True)
        self._out.start()
        self._declared = _Declared(self._out.register_schema, self._out.register_channel)
        self.flush, self.finish = self._out.flush, self._out.finish

    def write(self, message: LoggedMessage) -> None:
        self._out.add_message(
            self._declared.channel(message), message.log_time_ns, message.payload, message.log_time_ns
        )


class _Foxglove:
    """foxglove-sdk's, in Rust, on one thread as ours.

    A write that fails is logged by it and raised at the next flush only, without its cause; a message has no sequence.
    """

    def __init__(self, file: IO[bytes], compression: MCAPCompression, level: int) -> None:
        self._context = foxglove.Context()
        options = MCAPWriteOptions(compression=compression, compression_level=level, compression_threads=0)
        self._out = foxglove.open_mcap(file, context=self._context, writer_options=options)
        self._channels: dict[str, foxglove.Channel] = {}
        self.flush, self.finish = self._out.flush, self._out.close

    def write(self, message: LoggedMessage) -> None:
        channel, schema = message.channel, message.schema
        if channel.topic not in self._channels:
            self._channels[channel.topic] = foxglove.Channel(
                channel.topic,
                schema=foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                message_encoding=channel.message_encoding,
                context=self._context,
            )
        self._channels[channel.topic].log(message.payload, log_time=message.log_time_ns)


WRITERS: dict[str, Callable[[IO[bytes]], MessageWriter]] = {
    "ours": _Ours,
    "mcap zstd": partial(_Mcap, compression=CompressionType.ZSTD),
    "mcap lz4": partial(_Mcap, compression=CompressionType.LZ4),
    "foxglove zstd 1": partial(_Foxglove, compression=MCAPCompression.Zstd, level=1),
    "foxglove zstd 3": partial(_Foxglove, compression=MCAPCompression.Zstd, level=3),
    "foxglove lz4": partial(_Foxglove, compression=MCAPCompression.Lz4, level=0),
}
"""``mcap`` offers no level of zstd: it takes the default, 3."""
