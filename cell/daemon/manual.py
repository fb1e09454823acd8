"""Mode Manual: a person moves the arm in small steps, while they hold a button; nothing is picked meanwhile.

It is a mode of the unit, as PackML has it, in the state Stopped: the machine's states do not change. Every motion is
planned among the known boxes, passes the gate and the node's guard, and is one short step, or goes on only while its
command is said again. A stop, an abort and a lost lease bring it to rest; after a stop the mode must be set again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from bus.commands import CommandReply, CommandRequest, UnitMode
from bus.errors import CellError, Refused
from bus.messages import ArmMode
from bus.threads import OwnedThread, Role
from cell.daemon.publisher import Publisher
from cell.machine.gate import Gate
from cell.machine.leases import CELL_CLIENT
from cell.machine.states import ENDING, MANUAL_MOTIONS, MODE_FROM, PRODUCTION_ONLY, State, available
from cell.pick.equipment import Equipment
from planning.jog import jog
from planning.motion import move
from planning.scene import Scene

FRESH_S = 0.5
"""A motion that must be said again ends so long after it was last said."""
_LOOK_S = 0.02
_AXES = {"x": 0, "y": 1, "z": 2}
_AGAIN = frozenset({"jog_home"})
"""Motions that last longer than one step: they end unless they are commanded again."""


_ADVICE = {
    "COLLISION": "Jog away from it, or to another side.",
    "UNREACHABLE": "Jog along another axis, or back.",
    "MOTION_REFUSED": "Jog along another axis, or back.",
}

Motion = Callable[[], object]


class Manual:
    """The mode of a cell, and the motions by hand.

    Args:
        post_stop: lets the machine stop, for a reason; called by its owner thread.
        now_s: a clock that only goes forward.

    Attributes:
        mode: ``Production`` or ``Manual``.
    """

    def __init__(
        self,
        equipment: Equipment,
        gate: Gate,
        publisher: Publisher,
        post_stop: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._e, self._gate, self._publisher, self._post_stop, self._now_s = (
            equipment, gate, publisher, post_stop, now_s)  # fmt: skip
        self.mode: UnitMode = "Production"
        self._change = threading.Lock()
        self._moving = self._granted = self._told = ""
        self._said_s = 0.0

    @property
    def is_moving(self) -> bool:
        """True from the acceptance of a motion by hand until it is over."""
        return self._moving != ""

    # --- the machine's owner thread -----------------------------------------------------------------------------------

    def beside(self, verb: str, request: CommandRequest, state: State) -> CommandReply | None:
        """Process a command of this mode; None for any other. Raises: Refused."""
        if verb == "mode":
            self._set(request, state)
        elif verb in MANUAL_MOTIONS:
            self._grant(verb, request, state)
        elif verb in ENDING and self.mode == "Manual" and request.client_id != CELL_CLIENT:
            self.end(f"{verb!r} from {request.client_id or 'a client'}")
            if verb == "abort" or state is not State.STOPPED:
                return None
        elif verb in PRODUCTION_ONLY and (self.mode == "Manual" or self.is_moving):
            raise self._refused(f"{verb!r} is not possible in mode Manual.", "First `cell mode production`.", state)
        else:
            return None
        return CommandReply(ok=True, state=state, available=available(state, mode=self.mode))

    def _set(self, request: CommandRequest, state: State) -> None:
        if request.mode is None:
            raise self._refused("The command names no mode.", "mode: Production or Manual.", state, "BAD_MODE")
        if self.is_moving:
            raise self._refused("The arm moves by hand.", "Let it come to rest first.", state, "STILL_RUNNING")
        if state not in MODE_FROM:
            where = ", ".join(sorted(MODE_FROM))
            raise self._refused(
                f"The mode cannot change while the cell is {state}.", f"It can in: {where}.", state, "WRONG_STATE"
            )
        is_new, self.mode = request.mode != self.mode, request.mode
        who = request.client_id or "a client"
        if is_new:
            self._publisher.publish_event("MODE", "info", f"Mode {self.mode}, by {who}.")
            self._publisher.publish_jobs()
        if self.mode == "Manual" and state in (State.IDLE, State.COMPLETE):
            self._post_stop(f"mode Manual from {who}")

    def _grant(self, verb: str, request: CommandRequest, state: State) -> None:
        if self.mode != "Manual":
            raise self._refused(f"{verb!r} is for mode Manual.", "First `cell mode manual`.", state)
        if state is not State.STOPPED:
            advice = "First `cell clear`." if state is State.ABORTED else "Wait until the cell is Stopped."
            raise self._refused(f"{verb!r} is not possible while the cell is {state}.", advice, state, "WRONG_STATE")
        if verb == "jog" and not (request.axis in _AXES and request.direction in (-1, 1)):
            raise self._refused(
                "A jog has an axis and a direction.", "axis: x, y, z; direction: 1, -1.", state, "BAD_JOG"
            )
        with self._change:
            self._said_s = self._now_s()
            if self._moving == verb and verb in _AGAIN:
                return
            if self._moving:
                raise self._refused(f"{self._moving!r} is not over yet.", "Send it again then.", state, "MOVING")
            self._moving = self._granted = verb
            self._gate.clear()
        self._publisher.publish_stage(verb)

    def _refused(self, text: str, advice: str, state: State, code: str = "WRONG_MODE") -> Refused:
        return Refused(text, advice, code=code, available=available(state, mode=self.mode), state=state)

    def end(self, why: str) -> None:
        """End the mode, and all motion by hand: it is Production again. Any thread may call it; it does not wait."""
        if self.mode == "Production" and not self.is_moving:
            return
        self.mode = "Production"
        self.rest()
        text = f"Mode Manual ended: {why}."
        self._publisher.publish_event("MODE", "info", text, "`cell mode manual` sets it again.")
        self._publisher.publish_jobs()

    def rest(self) -> None:
        """Bring a motion by hand to rest; without one it does nothing. Any thread may call it."""
        with self._change:
            if not self._moving:
                return
            self._gate.halt()
        OwnedThread(Role.ACTION, self._stop_devices, of="rest").start()  # the caller may not wait for a device

    def _stop_devices(self) -> None:
        self._e.arm.stop()
        self._e.hand.stop()

    # --- the thread of the command ------------------------------------------------------------------------------------

    def run(self, verb: str, request: CommandRequest) -> None:
        """Plan the granted motion, and begin it. Raises: Refused, with the reason why it is not possible."""
        with self._change:
            if self._granted != verb:
                return
            self._granted = ""
        try:
            motion = self._planned(verb, request)
        except CellError as error:
            self._over()
            raise Refused(error.text, _ADVICE.get(error.code, error.advice), code=error.code) from error
        except BaseException:
            self._over()
            raise
        self._tell(verb, request)
        OwnedThread(Role.ACTION, lambda: self._move(verb, motion), of=verb).start()

    def _planned(self, verb: str, request: CommandRequest) -> Motion:
        e, settings = self._e, self._e.station.manual
        if verb == "hand_open":
            return lambda: e.hand.move(e.station.hand.max_width_m, settings.hand_m_s)
        if verb == "hand_close":
            return lambda: e.hand.grasp(e.station.hand.grasp_force_n, settings.hand_m_s)
        state, hand = e.arm.state(), e.hand.state()
        if state.mode is not ArmMode.IDLE:
            raise Refused(f"The arm is not idle: it reports {state.mode.value}.", "`cell abort`, then `cell clear`.")
        if verb == "jog":
            scene, shift_m = Scene.of(e.robot, e.station, cancel=self._gate.cancel), np.zeros(3)
            shift_m[_AXES[str(request.axis)]] = (request.direction or 0) * settings.jog_m
            trajectory = jog(scene, state.q_rad, hand.width_m, shift_m, settings.jog_m_s)
        else:
            slow = e.station.arm.model_copy(update={"speed": e.station.arm.speed * settings.home_speed})
            station = e.station.model_copy(update={"arm": slow})
            scene = Scene.of(e.robot, station, cancel=self._gate.cancel)
            trajectory = move(scene, state.q_rad, np.asarray(station.arm.capture_q_rad))
        return lambda: e.arm.execute(trajectory)

    def _tell(self, verb: str, request: CommandRequest) -> None:
        """Publish who moves what, once for all steps of one hold of the button."""
        sign = "+" if (request.direction or 0) > 0 else "-"
        what = f"jog {sign}{request.axis}" if verb == "jog" else verb.replace("_", " ")
        told = f"{request.client_id}: {what}"
        if told != self._told or verb != "jog":
            self._publisher.publish_event("JOG", "info", f"{what} by {request.client_id or 'a client'}.")
        self._told = told

    def _move(self, verb: str, motion: Motion) -> None:
        over = threading.Event()
        watch = None
        if verb in _AGAIN:
            watch = OwnedThread(Role.ACTION, lambda: self._watch(over), of=verb).start()
        try:
            with self._gate.motion() as may_begin:
                if may_begin:
                    motion()
        except CellError as error:
            self._publisher.publish_event(error.code, "warning", f"{verb}: {error.text}", error.advice)
        finally:
            over.set()
            if watch is not None:
                watch.join()
            self._over()

    def _watch(self, over: threading.Event) -> None:
        """Bring the arm to rest when the command is not said again, or the cell has halted otherwise."""
        while not over.wait(_LOOK_S):
            if self._gate.halted or self._now_s() - self._said_s > FRESH_S:
                self.rest()
                return

    def _over(self) -> None:
        with self._change:
            self._gate.halt()  # as a Stopped cell is
            self._moving = self._granted = ""
        self._publisher.publish_stage("")
