"""Settings of the real devices, read by the drivers of the same names."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from config.base import Address, Finite, NonNegative, Positive, Seconds, Settings, SystemPath, Vector

Wrench = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
PositiveJoints = tuple[Positive, Positive, Positive, Positive, Positive, Positive, Positive]


class LoadSettings(Settings):
    """The load on the flange besides the hand that Desk knows: the camera, its bracket, cables.

    Attributes:
        mass_kg: weigh it: an undeclared mass reads as an external force.
        flange_from_center_m: its centre of mass in ``flange``.
        inertia_kg_m2: diagonal of its inertia about that centre.
    """

    mass_kg: Annotated[float, Field(ge=0, le=10)] = 0.0
    flange_from_center_m: Vector = (0.0, 0.0, 0.0)
    inertia_kg_m2: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)


class Fr3Settings(Settings):
    """A Franka Research 3, driven over its control interface (FCI, libfranka 0.21, robot system 5.9 or newer).

    Attributes:
        address: of the robot's control box.
        realtime: ``enforce`` refuses to move without a PREEMPT_RT kernel; ``ignore`` is for simulators.
        collision_torque_nm: external joint torques at which the arm stops itself (reflex).
        collision_wrench: external force [N] and torque [Nm] at the tcp at which it stops itself.
        joint_stiffness_nm_rad: of the robot's own impedance controller, which follows our commands.
        load: see `LoadSettings`; the hand's own mass is set in Desk (End Effector).
    """

    address: Address = "172.16.0.2"
    realtime: Literal["enforce", "ignore"] = "enforce"
    collision_torque_nm: PositiveJoints = (
        20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0,
    )  # fmt: skip
    collision_wrench: Wrench = (20.0, 20.0, 20.0, 25.0, 25.0, 25.0)
    joint_stiffness_nm_rad: PositiveJoints = (3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0)
    load: LoadSettings = LoadSettings()


class PandaHandSettings(Settings):
    """A Franka hand, mounted on the arm and reached at the arm's address.

    Attributes:
        address: of the robot's control box.
        poll_s: period of reading its width; each reading takes the hand 30 to 100 ms.
    """

    address: Address = "172.16.0.2"
    poll_s: Seconds = 0.05


class FemtoMegaSettings(Settings):
    """An Orbbec Femto Mega on Ethernet or USB.

    Attributes:
        address: its fixed IP address (as delivered 192.168.1.10); None = find it by ``serial``.
        serial: its serial number; with an address it is checked.
        settle_frames: number of frames, at least, before the first one is used (auto-exposure).
        fixed_exposure: keep the exposure that auto-exposure found.
        extensions: folder of the SDK's extension libraries, whose licence is for Orbbec's cameras only; None = its own.
        lost_after_s: without a frame for so long the camera counts as lost, and is connected anew.
    """

    address: str | None = None
    serial: str | None = None
    settle_frames: Annotated[int, Field(ge=1, le=300)] = 20
    fixed_exposure: bool = False
    extensions: SystemPath | None = None
    lost_after_s: Annotated[Finite, Field(gt=0.2, le=30)] = 0.8

    @model_validator(mode="after")
    def _one_can_be_found(self) -> FemtoMegaSettings:
        if self.address == "" or self.serial == "":
            raise ValueError("leave address or serial out instead of giving it empty")
        return self
