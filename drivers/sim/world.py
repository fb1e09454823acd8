"""One MuJoCo world behind the simulated devices. Time passes only while a device acts: as fast as possible, or paced.

All access goes through one lock; a tick is one millisecond of robot time. Frames: docs/frames.md.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext

import mujoco
import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, Transform
from bus.errors import ConfigError
from bus.transforms import from_rotation
from config.schema import Station
from drivers.sim.clutter import fill
from drivers.sim.fingers import Fingers
from drivers.sim.heap import heap
from drivers.sim.objects import name_in_order, object_names, require_presentable
from drivers.sim.optics import FOVY_DEG, hand_from_cameras
from drivers.sim.placing import OBJECT, Placing
from drivers.sim.robot import arm_joints, joined_models
from drivers.sim.scene import FINGER_JOINTS, HAND_ACTUATOR, compose
from drivers.sim.shown import show_what_is_touched
from drivers.sim.turns import Turns

_log = logging.getLogger(__name__)
TICK_S = 0.001
_SETTLE_TICKS = 800
_DRAWS = 20
_PACE_TICKS = 10


class World:
    """The simulated cell.

    Args:
        station: its configuration (scene, camera mounting, `sim` settings).
        clock_ns: UTC clock for the stamps of states.

    Attributes:
        lock: guards model and data. ``turns``: who makes time pass.
        names: the objects that can be presented. ``objects``: free body -> name of its object.
        presented: seed of the newest presentation. ``presentations``: their number.
    """

    def __init__(self, station: Station, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self.station = station
        self.clock_ns = clock_ns
        self.lock = threading.RLock()
        self.turns = Turns()
        self._fingers: Fingers | None = None
        require_presentable(station.sim.objects, station.scene.pick_region_m)
        self.names = object_names(station.sim.objects)
        self.objects: dict[str, str] = {}  # free body -> name of the object
        self.presented = 0  # the seed
        self.presentations = 0
        self._q_command_rad = np.array(station.arm.capture_q_rad)
        self._dq_command_rad_s = np.zeros_like(self._q_command_rad)
        self._hand_target_m = station.hand.max_width_m / 2
        self._paced_s: tuple[float, float] = (0.0, 0.0)
        clutter, seed = station.sim.clutter, station.sim.seed
        filling = {f"{OBJECT}-{index}": name_in_order(self.names, seed, index) for index in range(clutter)}
        self._load({} if station.sim.board else filling or {OBJECT: self.names[0]})
        self._set_arm(self._q_command_rad, self._hand_target_m)
        if station.sim.board:
            return
        if filling:
            self._fill(seed)
        else:
            self._present_first(seed)

    # --- time ---------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Simulate one millisecond with the present commands; the caller need not hold the lock."""
        with self.lock:
            fingers = self._fingers
            if fingers is None:
                self._step()
                return
            fingers.begin_tick()
            if not fingers.is_over:
                self._command_fingers(fingers)
                self._step()
                fingers.end_tick(self.hand_width_m(), -float(self.data.actuator_force[self._hand_actuator]) / 2)
                self._command_fingers(fingers)
            else:
                self._step()
            if fingers.is_over:
                self._fingers = None
        if fingers.is_over:
            self.turns.wake()

    def _step(self) -> None:
        data = self.data
        data.ctrl[self._arm_actuators] = self._q_command_rad + self._lag_s * self._dq_command_rad_s
        data.ctrl[self._hand_actuator] = self._hand_target_m
        mujoco.mj_step(self.model, data)

    def time_s(self) -> float:
        """Return the simulated time."""
        with self.lock:
            return float(self.data.time)

    def pace(self, ticks: int) -> None:
        """In paced mode, sleep so that each ten ``ticks`` take their real time."""
        factor = self.station.sim.pace
        if factor > 0 and ticks % _PACE_TICKS == 0:
            due_s = self._paced_s[1] + _PACE_TICKS * TICK_S / factor
            now_s = time.monotonic()
            due_s = due_s if now_s - due_s < 0.1 else now_s  # after a pause, do not catch up
            time.sleep(max(0.0, due_s - now_s))
            self._paced_s = (now_s, due_s)

    # --- objects ------------------------------------------------------------------------------------------------------

    def present(self, name: str, seed: int) -> None:
        """Replace the object by ``name`` at a seeded pose, and let it come to rest.

        Raises:
            ConfigError: unknown object, or one that does not come to rest inside the pick region; or the table was
                filled with several or holds the calibration board.
        """
        if self.station.sim.board:
            raise ConfigError("The calibration board lies on the table: no object is presented.", "sim.board = false")
        if self.station.sim.clutter > 0:
            raise ConfigError("The table was filled with several objects: none is presented.", "Set sim.clutter = 0.")
        if name not in self.names:
            raise ConfigError(f"Unknown object {name!r}.", f"There are: {', '.join(self.names)}.")
        rng = np.random.default_rng([seed % 2**64, *name.encode()])
        with self.turns.taken():  # the lock is taken only briefly, so that the arm's state can still be read
            if name != self.objects[OBJECT]:
                self._load({OBJECT: name})
            self.presented = seed
            self.presentations += 1
            table = Placing(self.model, self.data, self.station.scene.pick_region_m)
            for _ in range(_DRAWS):
                with self.lock:
                    table.stand(rng.uniform(-np.pi, np.pi))
                self._settle()
                with self.lock:
                    table.shift_into_region(rng.uniform(size=2))
                self._settle()
                if table.rests_inside():
                    return
        raise ConfigError(
            f"The object {name!r} does not come to rest in the pick region.", "Is it too big, or does it roll?"
        )

    def _present_first(self, seed: int) -> None:
        """Present the first object; one that cannot be is refused when a cycle asks for it."""
        try:
            self.present(self.names[0], seed)
        except ConfigError as error:
            _log.warning("%s", error)

    def _fill(self, seed: int) -> None:
        """Lay or drop all objects into the pick region, once.

        Raises: ConfigError, DriverError, as `clutter.fill` and `heap.heap`.
        """
        region_m = self.station.scene.pick_region_m
        with self.turns.taken(), self.lock:
            placings = [Placing(self.model, self.data, region_m, body) for body in self.objects]
            rng = np.random.default_rng([seed % 2**64, len(placings)])
            if self.station.sim.heaped:
                heap(placings, placings[0].region(), rng, self._pass)
            else:
                fill(placings, placings[0].region(), rng, self._settle)
            self.presented, self.presentations = seed, 1

    def base_from_object(self, body: str = OBJECT) -> Transform:
        """Return the true pose (4, 4) [m] of an object's body in ``base``."""
        with self.lock:
            truth = self.data.body(body)
            return from_rotation(truth.xmat.reshape(3, 3), truth.xpos)

    def _settle(self) -> None:
        self._pass(_SETTLE_TICKS)

    def _pass(self, ticks: int) -> None:
        for _ in range(ticks):
            self.tick()

    # --- arm and hand -------------------------------------------------------------------------------------------------

    def command_arm(self, q_rad: Joints, last_q_rad: Joints) -> None:
        """Set the arm's position (n,) for the next tick; its rate since ``last_q_rad`` (n,) is fed forward."""
        with self.lock:
            self._dq_command_rad_s = (q_rad - last_q_rad) / TICK_S
            self._q_command_rad = np.array(q_rad)

    def move_fingers(self, fingers: Fingers) -> None:
        """Return when ``fingers`` are over: they move with the ticks of the arm, or while it rests with their own."""
        with self.lock:
            self._fingers = fingers
        ticks = itertools.count()

        def tick() -> None:
            self.tick()
            self.pace(next(ticks))

        self.turns.ride(lambda: fingers.is_over, tick)

    def _command_fingers(self, fingers: Fingers) -> None:
        self._hand_target_m = fingers.target_m / 2
        self.model.actuator_forcerange[self._hand_actuator] = (-2 * fingers.force_n, 2 * fingers.force_n)

    def pose_robot(self, q_rad: Joints, width_m: float) -> None:
        """Put the arm at ``q_rad`` (n,) and the fingers at ``width_m`` at once, at rest: mirrors a robot elsewhere."""
        with self.lock:
            self._set_arm(q_rad, width_m / 2)

    def arm(self) -> tuple[Joints, Joints, Joints]:
        """Return measured positions [rad], velocities [rad/s] and external torques [Nm] of the arm, each (joints,)."""
        with self.lock:
            q_rad = self.data.qpos[self._arm_qpos].copy()
            return q_rad, self.data.qvel[self._arm_dofs].copy(), self._external_torque_nm()

    def arm_speed_rad_s(self) -> Joints:
        """Return the measured joint velocities (joints,)."""
        with self.lock:
            return np.array(self.data.qvel[self._arm_dofs])

    def hand_width_m(self) -> float:
        """Return the measured distance between the pads."""
        with self.lock:
            return float(self.data.qpos[self._finger_qpos].sum())

    def _external_torque_nm(self) -> Joints:
        """Return the joint torques (joints,) of the robot's contacts: their forces through the contact Jacobians."""
        model, data = self.model, self.data
        torque_nm = np.zeros(model.nv)
        wrench, jacobian_p, jacobian_r = np.zeros(6), np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for index in range(data.ncon):
            contact = data.contact[index]
            sides = [self._is_robot[model.geom_bodyid[geom]] for geom in (contact.geom1, contact.geom2)]
            if sides[0] == sides[1]:
                continue
            mujoco.mj_contactForce(model, data, index, wrench)
            axes = contact.frame.reshape(3, 3)
            sign = 1.0 if sides[1] else -1.0  # the contact frame's force acts on geom2
            body = model.geom_bodyid[contact.geom2 if sides[1] else contact.geom1]
            mujoco.mj_jac(model, data, jacobian_p, jacobian_r, contact.pos, body)
            torque_nm += sign * (jacobian_p.T @ (axes.T @ wrench[:3]) + jacobian_r.T @ (axes.T @ wrench[3:]))
        return torque_nm[self._arm_dofs]

    # --- model --------------------------------------------------------------------------------------------------------

    def _load(self, objects: dict[str, str]) -> None:
        """Compile the cell with ``objects``; the robot keeps its state. The caller ensures that no device moves."""
        spec = compose(self.station, objects, hand_from_cameras(self.station), FOVY_DEG)
        try:
            with joined_models() if self.station.robot is not None else nullcontext():
                model: mujoco.MjModel = spec.compile()
        except ValueError as error:
            names = ", ".join(sorted(set(objects.values())))
            raise ConfigError(
                f"An object does not compile: {error}.", f"Correct the object.xml of: {names}."
            ) from error
        for body in objects:
            show_what_is_touched(model, body)
        with self.lock:
            old = getattr(self, "data", None)
            kept = None if old is None else (old.qpos[self._robot_qpos].copy(), old.qvel[self._robot_dofs].copy())
            self.model: mujoco.MjModel = model
            self.data: mujoco.MjData = mujoco.MjData(model)
            self.objects = dict(objects)
            self._index()
            if kept is not None:
                self.data.qpos[self._robot_qpos], self.data.qvel[self._robot_dofs] = kept

    def _index(self) -> None:
        model, arm = self.model, arm_joints(self.station)
        self._arm_qpos = _addresses(model.jnt_qposadr, model, arm)
        self._arm_dofs = _addresses(model.jnt_dofadr, model, arm)
        self._finger_qpos = _addresses(model.jnt_qposadr, model, FINGER_JOINTS)
        self._robot_qpos = np.concatenate([self._arm_qpos, self._finger_qpos])
        self._robot_dofs = np.concatenate([self._arm_dofs, _addresses(model.jnt_dofadr, model, FINGER_JOINTS)])
        self._arm_actuators = np.array([model.actuator(name).id for name in arm])
        self._hand_actuator = model.actuator(HAND_ACTUATOR).id
        gain, damping = model.actuator_gainprm[self._arm_actuators, 0], -model.actuator_biasprm[self._arm_actuators, 2]
        self._lag_s = damping / gain  # commanding q + lag * dq removes the servo's velocity lag
        root = model.body_rootid[model.jnt_bodyid[model.joint(arm[0]).id]]
        self._is_robot = np.array([model.body_rootid[body] == root for body in range(model.nbody)])

    def _set_arm(self, q_rad: Joints, finger_m: float) -> None:
        self.data.qpos[self._arm_qpos], self.data.qpos[self._finger_qpos] = q_rad, finger_m
        mujoco.mj_forward(self.model, self.data)


def _addresses(table: npt.NDArray[np.int32], model: mujoco.MjModel, joints: tuple[str, ...]) -> npt.NDArray[np.int64]:
    return np.array([table[model.joint(name).id] for name in joints], dtype=np.int64)
