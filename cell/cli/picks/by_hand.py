"""Motion by hand in mode Manual: ``cell mode``, ``jog``, ``jog-home``, ``hand-open``, ``hand-close``."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

import typer

from bus.commands import CommandRequest, UnitMode
from bus.errors import Refused
from cell.cli.options import Config, Set
from cell.cli.picks.pick import attended, connected
from cell.client import Client
from cell.machine.states import SETTLED
from cell.terminal.printing import out
from config.load import DEFAULT_STATION

_PATIENCE_S, _ATTENDED_S = 60.0, 600.0
_SAY_AGAIN_S = 0.1


def mode(
    name: Annotated[str, typer.Argument(metavar="MODE", help="manual or production.")],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """Set the mode of the unit: in manual the arm is moved by hand, in production it picks. Manual stops the cell."""
    modes: dict[str, UnitMode] = {"manual": "Manual", "production": "Production"}
    if name.lower() not in modes:
        raise typer.BadParameter(f"{name!r} is neither manual nor production.")
    with connected("mode", config, overrides) as cell:
        cell.send("mode", CommandRequest(mode=modes[name.lower()]))
        state = cell.wait_for_state(set(SETTLED), _PATIENCE_S)
    out.line(f"{state.mode}: {state.state}")


def jog(
    direction: Annotated[str, typer.Argument(metavar="DIRECTION", help="x+, x-, y+, y-, z+ or z-, of base.")],
    steps: Annotated[int, typer.Option(min=1, max=100, help="How many steps (manual.jog_m each).")] = 1,
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """In mode manual: move the tcp straight by small steps. Ctrl-C ends it within one step."""
    axes: dict[str, Literal["x", "y", "z"]] = {"x": "x", "y": "y", "z": "z"}
    if len(direction) != 2 or direction[0] not in axes or direction[1] not in "+-":
        raise typer.BadParameter(f"{direction!r} is none of x+, x-, y+, y-, z+, z-.")
    step = CommandRequest(axis=axes[direction[0]], direction=1 if direction[1] == "+" else -1)
    with attended(), connected("jog", config, overrides) as cell:
        for _ in range(steps):
            _by_hand(cell, "jog", step)
    out.line(f"jogged {direction}, {steps} {'step' if steps == 1 else 'steps'}")


def jog_home(config: Config = DEFAULT_STATION, overrides: Set = None) -> None:
    """In mode manual: move slowly to the capture pose, around the known boxes. Ctrl-C ends it."""
    _once("jog_home", "at rest", config, overrides, again=True)


def hand_open(config: Config = DEFAULT_STATION, overrides: Set = None) -> None:
    """In mode manual: open the hand."""
    _once("hand_open", "the hand is open", config, overrides)


def hand_close(config: Config = DEFAULT_STATION, overrides: Set = None) -> None:
    """In mode manual: close the hand on what is there."""
    _once("hand_close", "the hand is closed", config, overrides)


def _once(verb: str, done: str, config: Path, overrides: list[str] | None, *, again: bool = False) -> None:
    """Command one motion by hand of a client of its own, and print ``done`` when it is over."""
    with attended(), connected(verb, config, overrides) as cell:
        _by_hand(cell, verb, CommandRequest(), again=again)
    out.line(done)


def _by_hand(cell: Client, verb: str, request: CommandRequest, *, again: bool = False) -> None:
    """Command one motion by hand, and wait until it is over; ``again``: say it again until then."""
    cell.send(verb, request)
    give_up_s = time.monotonic() + _ATTENDED_S
    while (state := cell.state()).stage == verb and time.monotonic() < give_up_s:
        if again:
            with suppress(Refused):  # it has just come to its end
                cell.send(verb, request)
        time.sleep(_SAY_AGAIN_S)
    if state.mode != "Manual":
        raise Refused(f"{verb!r} was stopped.", "`cell mode manual` sets the mode again.", code="STOPPED")
