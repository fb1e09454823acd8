"""Fault injection into the cell's own process: the goal-image model and the disk of the recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import BinaryIO

from bus.faulty_bus import Spoilable, answer_faults
from bus.frozen import Message
from bus.session import Bus
from bus.topics import Topic
from config.schema import Station
from logs.mcap.fault_injection import FaultyDisk
from logs.mcap.recorder import Output
from perception.models import Models
from perception.models.fault_injection import FaultyModel


class FaultInjection:
    """The parts of one cell that accept faults, each with its initial fault of the station file."""

    def __init__(self, station: Station) -> None:
        faults = station.faults
        self._station = station
        self._disk = FaultyDisk(faults.disk, delay_s=faults.delay_s)
        self._parts: dict[str, Spoilable] = {"disk": self._disk}

    def around(self, models: Models) -> Models:
        """Return the models with the one that imagines wrapped."""
        faults, deadline_s = self._station.faults, self._station.perception.hosted.deadline_s
        model = FaultyModel(models.imaginer, faults.model, deadline_s=deadline_s, delay_s=faults.delay_s)
        self._parts["model"] = model
        return replace(models, imaginer=model)

    def under(self, file: BinaryIO) -> Output:
        """Return a recording's file, on a disk that accepts faults."""
        return self._disk.under(file)

    def answer(self, bus: Bus, publish: Callable[[Topic, Message], None]) -> None:
        """Answer ``fault/{part}`` for these parts, and publish each change with ``publish``."""
        answer_faults(bus, self._parts, publish)
