"""Lifts a judged grasp in MuJoCo: there, close, up 10 cm, hold. World = ``table``; the hand slides along the approach,
and back along it where it came from above; where it came from a side, straight up.

The fingers are those of drivers/sim: flat jaws, coupled, with its contact and force. No arm: it cannot bend away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.heaps.drop import add_body, furnish
from benchmarks.heaps.heap import FIXED, Heap
from benchmarks.heaps.plan import HEAPS, plan
from benchmarks.heaps.shapes import Shape
from benchmarks.heaps.swept import PALM_SIZE_M
from benchmarks.heaps.things import thing
from bus.transforms import apply, from_rotation, inverse
from config.devices import HandSettings
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M, PALM_ABOVE_TIP_M
from config.schema import Station

LIFT_M = 0.10
_HELD_SHARE = 0.8
"""A body that rose by this share of the lift is held."""
_TIMESTEP_S = 0.001
_DOWN_M, _DOWN_S, _CLOSE_S, _UP_S, _HOLD_S = 0.10, 0.5, 0.7, 0.8, 0.3
_LAG_S = 0.15
"""Until the servo is where it was sent."""
_TOUCH_N = 2.0
"""More force than this on the hand on its way down is a collision."""
_FRICTION = (0.8, 0.008, 0.8e-4)
_SOLREF, _SOLIMP = (0.004, 1.0), (0.97, 0.995, 0.001, 0.5, 2.0)
_STIFFNESS_N_M, _DAMPING_NS_M = 20_000.0, 400.0
_SLIDE_STIFFNESS_N_M, _SLIDE_DAMPING_NS_M = 50_000.0, 1_000.0
_SQUEEZE_M = 0.010
_FROM_ABOVE = float(np.cos(np.deg2rad(20)))
"""Least vertical share of an approach from above."""
_JAW_ROOT_M = 0.010

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lifted:
    """The result of a lift in physics.

    Attributes:
        touched: whether the hand met something on the way down.
        held: indices of the bodies that rose with the hand.
        unstable: whether the simulation broke off; then nothing counts as held.
    """

    touched: bool
    held: tuple[int, ...]
    unstable: bool = False


def lift(heap: Heap, base_from_tcp: Array, opening_m: float) -> Lifted:
    """Simulate one lift of the scene as it was seen."""
    from_above = bool((heap.base_from_table[:3, 2] @ base_from_tcp[:3, 2]) < -_FROM_ABOVE)
    rising = "slide" if from_above else "up"
    model = _compose(heap, base_from_tcp, rising).compile()
    data = mujoco.MjData(model)
    hand = heap.station().hand
    open_m = min(opening_m, hand.max_width_m) / 2
    data.joint("slide").qpos[0] = _DOWN_M
    data.joint("left").qpos[0] = data.joint("right").qpos[0] = open_m
    touched = _move(model, data, "slide", (_DOWN_M, 0.0), (open_m, open_m), _DOWN_S)
    touched |= _move(model, data, "slide", (0.0, 0.0), (open_m, open_m), _LAG_S)
    bodies = [model.body(f"loose-{index}").id for index in _loose(heap)]
    before_m = data.xipos[bodies, 2].copy()
    _move(model, data, "slide", (0.0, 0.0), (open_m, -_SQUEEZE_M), _CLOSE_S)
    _move(model, data, rising, (0.0, LIFT_M), (-_SQUEEZE_M, -_SQUEEZE_M), _UP_S)
    _move(model, data, rising, (LIFT_M, LIFT_M), (-_SQUEEZE_M, -_SQUEEZE_M), _HOLD_S)
    if data.warning[mujoco.mjtWarning.mjWARN_BADQACC.value].number:
        return Lifted(touched, (), True)
    rose = data.xipos[bodies, 2] - before_m > _HELD_SHARE * LIFT_M
    return Lifted(touched, tuple(index for index, up in zip(_loose(heap), rose, strict=True) if up))


def _loose(heap: Heap) -> list[int]:
    return sorted({part.body for part in heap.parts} - {FIXED})


def _move(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    servo: str,
    hand_m: tuple[float, float],
    fingers_m: tuple[float, float],
    time_s: float,
) -> bool:
    """Move the hand by one servo and the fingers, from and to; return whether the hand met anything."""
    steps = round(time_s / _TIMESTEP_S)
    hand = {model.body(name).id for name in ("hand", "left", "right")}
    touched = False
    for share in np.linspace(0, 1, steps):
        data.actuator(servo).ctrl[0] = hand_m[0] + share * (hand_m[1] - hand_m[0])
        data.actuator("left").ctrl[0] = fingers_m[0] + min(1.0, 2 * share) * (fingers_m[1] - fingers_m[0])
        mujoco.mj_step(model, data)
        touched = touched or _force_n(model, data, hand) > _TOUCH_N
    return touched


def _force_n(model: mujoco.MjModel, data: mujoco.MjData, hand: set[int]) -> float:
    """Largest normal force of a contact between the hand and anything else."""
    wrench, largest = np.zeros(6), 0.0
    for index in range(data.ncon):
        sides = [int(model.geom_bodyid[geom]) in hand for geom in data.contact[index].geom]
        if sides[0] != sides[1]:
            mujoco.mj_contactForce(model, data, index, wrench)
            largest = max(largest, float(wrench[0]))
    return largest


# --- the world --------------------------------------------------------------------------------------------------------


def _compose(heap: Heap, base_from_tcp: Array, rising: str) -> mujoco.MjSpec:
    station, table_from_base = heap.station(), inverse(heap.base_from_table)
    spec = mujoco.MjSpec()
    spec.option.timestep = _TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # the stiff servos' damping
    furnish(spec, station)
    for body in _loose(heap):
        parts = tuple(apply(table_from_base, part.corners) for part in heap.parts if part.body == body)
        add_body(spec, f"loose-{body}", [Shape(heap.names[body], parts, _density(heap, body))], [(0.5, 0.5, 0.5, 1.0)])
    _add_hand(spec, station, table_from_base @ base_from_tcp, rising)
    return spec


def _density(heap: Heap, body: int) -> float:
    if heap.set_name != HEAPS:
        return thing(plan(heap.n, heap.seed, heap.set_name)).density_kg_m3
    return 700.0 if heap.names[body] == "box" else 1250.0


def _add_hand(spec: mujoco.MjSpec, station: Station, table_from_tcp: Array, rising: str) -> None:
    """Add the palm on a slide against the approach, where it is to rise "up" on one along the world's z, too.

    The two fingers are on slides along the closing axis.
    """
    tip = table_from_tcp @ from_rotation(np.eye(3), (0.0, 0.0, FINGER_TIP_M))
    turn = Rotation.from_matrix(tip[:3, :3]).as_quat(scalar_first=True)
    hand = spec.worldbody.add_body(name="hand", pos=tip[:3, 3], quat=turn, gravcomp=1.0)
    _add_slide(hand, "slide", (0.0, 0.0, -1.0))
    if rising == "up":
        _add_slide(hand, "up", tip[2, :3].tolist())
    hand.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=(0.0, 0.0, -PALM_ABOVE_TIP_M - 0.03),
        size=(PALM_SIZE_M[0] / 2, PALM_SIZE_M[1] / 2, 0.03), mass=0.7,
    )  # fmt: skip
    for name, side in (("left", -1.0), ("right", 1.0)):
        _add_finger(hand, name, side, station.hand)
    spec.add_exclude(bodyname1="left", bodyname2="right")
    equal = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1="left", name2="right")
    equal.objtype = mujoco.mjtObj.mjOBJ_JOINT
    equal.data[:5] = (0.0, 1.0, 0.0, 0.0, 0.0)
    _add_servo(spec, "slide", _SLIDE_STIFFNESS_N_M, _SLIDE_DAMPING_NS_M, 2_000.0)
    if rising == "up":
        _add_servo(spec, "up", _SLIDE_STIFFNESS_N_M, _SLIDE_DAMPING_NS_M, 2_000.0)
    _add_servo(spec, "left", _STIFFNESS_N_M, _DAMPING_NS_M, 2 * station.hand.grasp_force_n)


def _add_finger(hand: mujoco.MjsBody, name: str, side: float, settings: HandSettings) -> None:
    finger = hand.add_body(name=name, gravcomp=1.0)
    _add_slide(finger, name, (0.0, side, 0.0))
    length_m = FINGER_LENGTH_M - _JAW_ROOT_M
    finger.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=(0.0, side * settings.finger_thickness_m / 2, -length_m / 2),
        size=(settings.finger_width_m / 2, settings.finger_thickness_m / 2, length_m / 2),
        mass=0.015, condim=6, priority=1, friction=_FRICTION, solref=_SOLREF, solimp=_SOLIMP,
    )  # fmt: skip


def _add_slide(body: mujoco.MjsBody, name: str, axis: Sequence[float]) -> None:
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, armature=0.1)


def _add_servo(spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float, most_n: float) -> None:
    """Add a position servo with a largest force."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = stiffness
    servo.biasprm[:3] = 0.0, -stiffness, -damping
    servo.forcelimited, servo.forcerange[:] = True, (-most_n, most_n)
