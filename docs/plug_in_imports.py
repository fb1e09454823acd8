"""THE list of what a plug-in of another package imports of ours; docs/plug_ins.md is written from it.

A test compares it with what the packages of examples/ import.
"""

from __future__ import annotations

from typing import NamedTuple


class Section(NamedTuple):
    """The imports of one kind of plug-in: by module, its names, in the order of the page."""

    title: str
    imports: dict[str, tuple[str, ...]]


_ERRORS = ("DriverError", "DriverUnavailable", "DeviceAbsent", "NotConnected", "DeviceLost", "MotionRefused",
           "ArmReflex", "HandFault", "StaleFrame", "BadFrame")  # fmt: skip
SECTIONS = (
    Section(
        "Every plug-in",
        {
            "config.schema": ("Station",),
            "config.plug_ins": ("with_settings",),
            "bus.transforms": ("apply", "inverse"),
            "vlad_cell.testing": ("CameraSuite", "ArmSuite", "HandSuite", "DetectorSuite", "GoalModelSuite"),
        },
    ),
    Section(
        "A driver",
        {
            "drivers.interface": ("Devices", "Camera", "Arm", "Hand", "Reporting"),
            "bus.messages": ("HandState", "ArmState", "ArmMode", "Motion", "Frame", "CameraModel"),
            "bus.trajectory": ("Trajectory", "ContactGuard", "TICK_S"),
            "config.robot": ("limits_of",),
            "drivers.motion.stream": ("Stream",),
            "drivers.motion.stops": ("Stops",),
            "bus.errors": _ERRORS,
            "drivers.sim.devices": ("open_devices",),
        },
    ),
    Section(
        "A detector, a goal-image model",
        {
            "bus.cancel": ("Cancel",),
            "bus.codes": ("Code",),
            "bus.errors": ("CycleFailure",),
            "bus.messages": ("CameraModel", "Instance"),
        },
    ),
    Section(
        "A detector",
        {
            "perception.detectors.base": ("GraspDetector", "SeenScene", "SeenLook", "FoundGrasp"),
            "config.devices": ("HandSettings",),
        },
    ),
    Section(
        "A goal-image model",
        {
            "perception.models.base": ("GoalImageModel",),
            "perception.observed_object": ("ObservedObject", "RodColor", "Axis", "Answer", "GoalImage", "PaintedRod"),
            "bus.messages": ("Usage",),
            "perception.geometry.depth": ("Rgbd",),
            "perception.geometry.lift": ("lift", "project"),
            "perception.geometry.window": ("Window", "encode_png"),
            "perception.models.painter": ("paint",),
        },
    ),
)
