"""``cell calibrate``: find or check the camera's mounting in the hand, and print the board for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import cv2
import typer

from bus import topics
from bus.commands import Heartbeat
from bus.errors import CellError, ConfigError
from bus.session import Bus
from bus.transforms import to_wxyz
from cell.cli.options import Config, Json, Set
from cell.hand_eye_survey import Check, Surveyor, moved
from cell.nodes.supervisor import Supervisor
from cell.terminal.printing import out
from cell.terminal.signals import ending
from config.charuco import board_image
from config.clock import clock_of
from config.load import DEFAULT_STATION, load_station
from config.schema import Station
from config.station_file import mounting_lines, require_writable, write_mounting
from drivers.node.loops import Loop
from drivers.remote import remote_devices
from perception.hand_eye import HandEye
from planning.robot import Robot, hand_from_color

calibrate = typer.Typer(
    help="Where the camera sits in the hand: find it, check it.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)
_PIXELS_PER_M = 10_000.0
_HEARTBEAT_S = 0.1


def _unheard(_error: CellError) -> None:
    """Ignore a heartbeat that could not be published; the arm's node notices its absence."""


@contextmanager
def _surveyor(station: Station, quiet: bool) -> Iterator[Surveyor]:
    """A surveyor on the station's nodes, without a daemon; Ctrl-C stops the arm.

    Raises: PortOccupied while a cell runs; ConfigError without a board in simulation.
    """

    def say(line: str) -> None:
        if not quiet:
            out.line(line)

    if station.simulated and not station.sim.board:
        raise ConfigError("In this simulated cell lies no board.", "Lay it there: --set sim.board=true.")
    say(f"starting {', '.join(station.nodes)}; the arm will move")
    settings = station.bus
    with Bus.listen(station.cell_id, settings.endpoint, security=settings.zenoh, clock=clock_of(station)) as bus:
        supervisor = Supervisor(
            station, lambda name, code: say(f"the node {name!r} ended with exit code {code}"), seal=bus.seal
        )
        try:
            supervisor.start()
            devices = remote_devices(bus, station)
            assert devices.arm is not None, "every station has an arm"
            beating = Loop("heartbeat", _HEARTBEAT_S, lambda: bus.publish(topics.HEARTBEAT, Heartbeat()), _unheard)
            with ending(devices.arm.stop), closing(beating):
                yield Surveyor(devices, Robot(station), station, say)
        finally:
            supervisor.close()


@calibrate.command("hand-eye")
def find(
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only show the result; leave the file alone.")] = False,
    as_json: Json = False,
) -> None:
    """Look at the board from 15 sides and write where the camera sits into the station file. The arm moves."""
    station = load_station(config, overrides or [])
    if not dry_run:
        _require_writable(config)  # before the arm moves
    with _surveyor(station, as_json) as surveyor:
        found = surveyor.calibrate()
    position_m = found.hand_from_color[:3, 3].tolist()
    wxyz = to_wxyz(found.hand_from_color)
    off_mm, off_deg = moved(hand_from_color(station.camera), found.hand_from_color)
    note = (
        f"calibrated {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {len(found.views_px)} views, {found.rms_px:.2f} px, "
        f"certain to {found.uncertainty_mm:.2f} mm and {found.uncertainty_deg:.3f} deg"
    )
    if as_json:
        said = {"position_m": position_m, "wxyz": wxyz, "rms_px": found.rms_px,
                "uncertainty_mm": found.uncertainty_mm, "uncertainty_deg": found.uncertainty_deg,
                "views_px": found.views_px, "moved_mm": off_mm, "moved_deg": off_deg}  # fmt: skip
        out.json(said)
    else:
        _show(found, off_mm, off_deg)
    if dry_run:
        for line in () if as_json else mounting_lines(position_m, wxyz).values():
            out.line(line)
        return
    write_mounting(config, position_m, wxyz, note)
    if not as_json:
        out.line(f"written to {config}, the old values kept as comments")


def _require_writable(config: Path) -> None:
    """Raises: ConfigError when the station file cannot be written."""
    if config.samefile(DEFAULT_STATION):
        raise ConfigError(
            f"{config} is every simulated cell's, not yours to change.",
            "Name your own station file with --config; with --dry-run the result is only shown.",
        )
    require_writable(config)


def _show(found: HandEye, off_mm: float, off_deg: float) -> None:
    views = "  ".join(f"{px:.2f}" for px in found.views_px)
    out.line(f"residual {found.rms_px:.2f} px root mean square; each view: {views}")
    out.line(f"the board wanders by {found.spread_mm:.2f} mm and {found.spread_deg:.2f} deg between the views")
    out.line(f"the camera's place is certain to {found.uncertainty_mm:.2f} mm and {found.uncertainty_deg:.3f} deg")
    out.line(f"the camera sits {off_mm:.2f} mm and {off_deg:.2f} deg from where the station file had it")


def _show_disagreement(seen: Check) -> None:
    if seen.disagree_mm is None or seen.disagree_after_mm is None:
        return
    out.line(
        f"the depth of the looks disagrees by {seen.disagree_mm:.1f} mm; by {seen.disagree_after_mm:.1f} mm if the"
        f" camera sat {seen.looks_mm:.1f} mm and {seen.looks_deg:.2f} deg otherwise, as picks of several looks see it"
    )


@calibrate.command()
def check(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """Look at the board from five sides: is the calibration still right? Nothing is touched. Exit 1: it is not."""
    station = load_station(config, overrides or [])
    with _surveyor(station, as_json) as surveyor:
        seen = surveyor.check()
    good = seen.off_px <= station.calibration.max_off_px
    if as_json:
        out.json({"ok": good, **vars(seen)})
    else:
        out.line(f"corners are {seen.off_px:.2f} px ({seen.off_mm:.2f} mm) off, the worst {seen.worst_px:.2f} px")
        out.line(
            f"the camera sits {seen.moved_mm:.1f} mm and {seen.moved_deg:.2f} deg from its calibration, "
            f"give or take {seen.uncertainty_mm:.1f} mm and {seen.uncertainty_deg:.2f} deg"
        )
        out.line(f"depth reads {seen.depth_off_mm:+.1f} mm against the corners")
        _show_disagreement(seen)
        verdict = (
            "good" if good else f"more than {station.calibration.max_off_px:.1f} px: run `cell calibrate hand-eye`"
        )
        out.line(verdict)
    if not good:
        raise typer.Exit(1)


@calibrate.command()
def board(
    output: Annotated[Path, typer.Option("--output", "-o", help="PNG to write.")] = Path("board.png"),
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """Draw the board, to print at its true size and glue onto something flat."""
    settings = load_station(config, overrides or []).calibration
    if output.suffix.lower() != ".png":
        raise ConfigError(f"{output} is not the name of a PNG.", "Name a file that ends in .png.")
    _, png = cv2.imencode(".png", board_image(settings, _PIXELS_PER_M))
    try:
        output.write_bytes(png.tobytes())
    except OSError as error:
        raise ConfigError(f"Cannot write {output}: {error.strerror}.", "Name a file in a folder of yours.") from error
    width_mm, height_mm = (side * 1e3 for side in settings.size_m)
    out.line(
        f"{output}: print it {width_mm:.0f} x {height_mm:.0f} mm, without scaling (254 dpi); then measure a square:"
    )
    out.line(f"it must be {settings.square_m * 1e3:.1f} mm, or set calibration.square_m and marker_m to what it is.")
