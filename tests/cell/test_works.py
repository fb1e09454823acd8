"""What the machine's works leave behind when one of them fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus.codes import Code
from bus.commands import Presented, PresentRequest
from bus.errors import CycleFailure, DriverError
from bus.messages import CycleResult
from cell.cycle import Equipment
from cell.works import Works
from config.load import load_station
from drivers.registry import open_devices
from logs.reader import read_cycle
from perception.models import open_models
from planning.robot import Robot


class Restless:
    """A feeder whose objects roll away."""

    def present(self, request: PresentRequest) -> Presented:
        raise DriverError("The object 'ball' does not come to rest.", "Is it round?")

    def truth(self) -> Presented:
        raise NotImplementedError


def test_an_object_that_cannot_be_presented_is_the_reason_of_its_cycle(tmp_path: Path) -> None:
    station = load_station(None, [f"recording.folder={tmp_path}"])
    devices = open_devices("sim", station)
    assert devices.camera is not None and devices.arm is not None and devices.hand is not None
    for device in (devices.camera, devices.arm, devices.hand):
        device.connect()
    equipment = Equipment(devices.camera, devices.arm, devices.hand, Robot(station), station, open_models(station, {}))
    results: list[CycleResult] = []
    works = Works(equipment, Restless(), set, lambda topic, message: None, lambda stage: None, results.append)
    with pytest.raises(CycleFailure, match="does not come to rest"):
        works.begin()
    works.stop(lambda wait_s: True)
    (result,) = results
    assert (result.result, result.code) == ("ABORTED", Code.INTERNAL)
    assert "does not come to rest" in result.reason
    assert read_cycle(Path(result.recording)).result == result
