"""The station's schema: every setting with its unit in its name, its default, and its reason.

Unknown keys are errors. Values come from defaults < station file < ``--set key=value`` (see `config.load`).
"""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from bus.lazy import LazyModule
from bus.secured import is_loopback
from config.base import Chunk, Settings, wrong
from config.bus import BusSettings
from config.calibration import CalibrationSettings
from config.devices import ArmSettings, CameraSettings, CaptureSettings, HandSettings, NodeSettings
from config.fault_injection import FaultSettings
from config.hardware import FemtoMegaSettings, Fr3Settings, PandaHandSettings
from config.http import HttpSettings
from config.opcua import OpcuaSettings
from config.perception import PerceptionSettings
from config.pick import ExecuteSettings, ManualSettings, PlanningSettings, QueueSettings, RetrySettings, VerifySettings
from config.recording import RecordingSettings
from config.robot import RobotSettings, limits_of
from config.scene import SceneSettings
from config.simulation import SimSettings

# Imported when a value is checked with it, so that a program that only sends "stop" does not wait for it.
numpy: Any = LazyModule("numpy")
_MOST_RAD = 6.5
"""No joint turns farther: a larger number is in degrees."""


class Station(Settings):
    """The complete configuration of one cell.

    Attributes:
        cell_id: its name on the bus and in recordings; each cell of a fleet needs its own.
    """

    cell_id: Chunk = "sim"
    bus: BusSettings = BusSettings()
    recording: RecordingSettings = RecordingSettings()
    nodes: dict[Chunk, NodeSettings] = Field(min_length=1)
    camera: CameraSettings = CameraSettings()
    capture: CaptureSettings = CaptureSettings()
    robot: RobotSettings | None = None
    arm: ArmSettings = ArmSettings()
    hand: HandSettings = HandSettings()
    scene: SceneSettings = SceneSettings()
    perception: PerceptionSettings = PerceptionSettings()
    planning: PlanningSettings = PlanningSettings()
    execute: ExecuteSettings = ExecuteSettings()
    verify: VerifySettings = VerifySettings()
    retry: RetrySettings = RetrySettings()
    queue: QueueSettings = QueueSettings()
    manual: ManualSettings = ManualSettings()
    sim: SimSettings = SimSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    fr3: Fr3Settings = Fr3Settings()
    panda_hand: PandaHandSettings = PandaHandSettings()
    femto_mega: FemtoMegaSettings = FemtoMegaSettings()
    faults: FaultSettings = FaultSettings()
    http: HttpSettings = HttpSettings()
    opcua: OpcuaSettings = OpcuaSettings()

    @model_validator(mode="after")
    def _every_device_served_once(self) -> Station:
        served = [device for node in self.nodes.values() for device in node.serves]
        if sorted(served) != ["arm", "camera", "hand"]:
            raise wrong("nodes", f"must serve camera, arm and hand exactly once each; they serve {sorted(served)}")
        return self

    @model_validator(mode="after")
    def _describes_the_arm_that_is_there(self) -> Station:
        if self.robot is not None and any(node.driver == "fr3" for node in self.nodes.values()):
            raise wrong("robot", "describes another arm than the driver fr3's: leave [robot] out")
        return self

    @model_validator(mode="after")
    def _captures_within_the_joints_range(self) -> Station:
        if self.robot is None and "capture_q_rad" not in self.arm.model_fields_set:
            return self  # the default is the FR3's, and checking it would import NumPy
        q, range_ = numpy.array(self.arm.capture_q_rad), limits_of(self)
        if len(q) != range_.joints:
            raise wrong("arm.capture_q_rad", f"has {len(q)} numbers, and the arm {range_.joints} joints")
        beyond = range_.outside(q) or range_.stuck(q)
        if beyond is not None:
            meant = ": these look like degrees, give radians" if abs(q).max() > _MOST_RAD else ""
            raise wrong("arm.capture_q_rad", f"{beyond}{meant}")
        return self

    @model_validator(mode="after")
    def _feels_before_the_reflex(self) -> Station:
        reflex_n = min(self.fr3.collision_wrench[:3])
        if self.execute.contact_n >= reflex_n:
            raise wrong("execute.contact_n", f"must be below the arm's reflex, fr3.collision_wrench ({reflex_n:g} N)")
        return self

    @property
    def simulated(self) -> bool:
        """Whether a node stands in for real devices."""
        return any(node.driver == "sim" for node in self.nodes.values())

    @property
    def is_simulation(self) -> bool:
        """True when every device is simulated, and every process is on this machine."""
        bus = self.bus
        is_here = is_loopback(bus.endpoint) and bus.listen is None and bus.router is None
        return is_here and all(node.driver == "sim" for node in self.nodes.values())

    @property
    def silence_s(self) -> float:
        """Longest silence of the sender of motions (``bus.silence_s``); longer where simulated time is not real."""
        is_timeless = self.sim.pace == 0 and all(node.driver == "sim" for node in self.nodes.values())
        return max(self.bus.silence_s, self.bus.stale_s) if is_timeless else self.bus.silence_s
