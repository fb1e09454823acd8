"""Hears what travels on the bus: it is recorded, and what the cell's own nodes say is passed on."""

from __future__ import annotations

from bus import topics
from bus.sample import Sample
from bus.session import Bus
from cell.daemon.unit import Unit
from cell.nodes.health import NodeMonitor
from cell.nodes.speakers import Speakers, Twice, strange
from config.schema import Station


class Hearing:
    """Hears for a unit.

    Args:
        monitor: hears the nodes, too. ``on_twice``: called when two sessions answer as one node.
    """

    def __init__(self, bus: Bus, station: Station, unit: Unit, monitor: NodeMonitor, on_twice: Twice) -> None:
        self._bus, self._unit, self._monitor = bus, unit, monitor
        ours = [name for name, node in station.nodes.items() if node.run == "here"]
        self._speakers = Speakers(bus, set(station.nodes), on_twice, self._on_stranger, sealed=ours)

    def begin(self) -> None:
        """Begin to hear: what this process says, what others publish, and which nodes are there."""
        self._bus.tap = self._record
        for topic in topics.TOPICS:
            if topic.kind == "publish" and topic.logged:
                self._bus.subscribe(topic.key.replace("{name}", "*"), self._hear)
        self._speakers.listen()
        self._monitor.listen(self._bus)

    def is_ours(self, sample: Sample) -> bool:
        """Return whether a sample is of one of the cell's own nodes."""
        return self._speakers.is_ours(sample)

    def _record(self, sample: Sample) -> None:
        """Record a message of this process, or a reply to it."""
        log = self._unit.actions.log
        if log is not None:
            log.hear(sample)

    def _hear(self, sample: Sample) -> None:
        """Process a message that another process published on the cell's keys."""
        if self.is_ours(sample):
            self._record(sample)
            self._monitor.hear(sample)
            self._unit.in_hand.hear(sample)
        else:
            self._record(strange(sample))

    def _on_stranger(self, sample: Sample) -> None:
        who = f"session {sample.source[:8]}" if sample.source else "a program that does not say who it is"
        self._unit.publisher.publish_event(
            "STRANGER",
            "warning",
            f"{who} put something on {sample.key!r}, which is not its to say: it is recorded apart, and not believed.",
            "Find the program; only the cell and its nodes publish below cell/CELL_ID.",
        )
