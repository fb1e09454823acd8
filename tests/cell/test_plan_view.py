"""The picture of a plan: outlines of the robot, its way, the cloud - and the canvas that shows it in a browser."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cell.http
from bus.messages import NamedBox, PlannedPath, PlanView, Proposal
from cell.pick.plan_view import MOST_POINTS, sampled
from config.load import load_station
from config.scene import scene_boxes
from docs.browser import find_chromium
from planning.outlines import Outlines
from planning.robot import Robot
from tests.logs.browser import Page, chromium

SCRIPTS = [Path(cell.http.__file__).parent / "page" / name for name in ("plan_scene.js", "plan_view.js")]
STATION = load_station(None, [])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(STATION)


@pytest.fixture(scope="module")
def outlines(robot: Robot) -> Outlines:
    return Outlines(robot)


@pytest.fixture(scope="module")
def view(outlines: Outlines, robot: Robot) -> PlanView:
    """A reach of the arm by its first joint, among the station's boxes and a cloud like a wall."""
    home = np.asarray(STATION.arm.capture_q_rad)
    path = home + np.linspace(0, 1, 21)[:, None] * np.array([0.6, 0.2, 0, 0, 0, 0, 0])
    poses, tcp_m = outlines.along(path, 0.05)
    proposal = Proposal(
        proposal_id="c-0", cycle_id="c", grasp=0, base_from_tcp=robot.base_from_tcp(path[-1]), score=0.8,
        opening_m=0.05, object="a red thing", motion_s=1.0, segments_s={"reach": 1.0}, rejected=0, passed_over=0,
        until_ns=0,
    )  # fmt: skip
    reach = PlannedPath(
        name="reach", only_to_look=False, width_m=0.05, nearest_m={"table": 0.3},
        times_s=np.linspace(0, 1, 21), q_rad=path, tcp_m=tcp_m,
        base_from_frame=poses,
    )  # fmt: skip
    boxes = [NamedBox(name=box.name, center_m=np.array(box.center_m), size_m=np.array(box.size_m))
             for box in scene_boxes(STATION.scene)]  # fmt: skip
    y, z = np.meshgrid(np.linspace(-0.3, 0.3, 40), np.linspace(0, 0.2, 20))
    cloud_m = np.stack([np.full(800, 0.6), y.ravel(), z.ravel()], axis=1)
    return PlanView(
        proposal=proposal, is_open=True, frames=outlines.frames, parts=outlines.parts, segments=(reach,),
        boxes=tuple(boxes), cloud_m=cloud_m, cloud_rgb=np.tile([200, 30, 30], (800, 1)),
    )  # fmt: skip


def test_an_outline_is_a_closed_surface_around_a_volume(outlines: Outlines) -> None:
    assert {part.name for part in outlines.parts} >= {"link 0", "link 7", "hand", "left finger", "camera"}
    for part in outlines.parts:
        a, b, c = (part.vertices_m[part.faces[:, corner]].astype(float) for corner in range(3))
        assert (np.cross(a, b) * c).sum() / 6 > 1e-7, f"{part.name}: its faces look outwards"
        assert 4 <= len(part.faces) < 200


def test_an_outline_reaches_nearly_as_far_as_its_part(outlines: Outlines, robot: Robot) -> None:
    for part, hull in zip(outlines.parts, robot.hulls, strict=True):
        hull.geometry.computeLocalAABB()
        size_m = float(np.linalg.norm(hull.geometry.aabb_local.max_ - hull.geometry.aabb_local.min_))
        shown_m = float(np.linalg.norm(np.ptp(part.vertices_m, axis=0)))
        assert shown_m > 0.6 * size_m, part.name


def test_the_poses_are_the_planning_models_own(view: PlanView, robot: Robot) -> None:
    (path,) = view.segments
    for row in (0, 7, 20):
        assert np.allclose(path.tcp_m[row], robot.base_from_tcp(path.q_rad[row])[:3, 3], atol=1e-6)
    assert np.allclose(path.base_from_frame[:, 0], np.eye(4)[:3]), "the base stands still"


def test_a_motion_is_shown_twenty_times_a_second_with_its_end() -> None:
    times_s, q_rad = sampled(np.arange(7 * 1023, dtype=float).reshape(-1, 7))
    assert np.allclose(times_s[:3], [0, 0.05, 0.1]) and times_s[-1] == pytest.approx(1.022)
    assert q_rad[-1, 0] == 7 * 1022


def test_it_travels_as_it_is(view: PlanView) -> None:
    text = view.model_dump_json()
    again = PlanView.model_validate_json(text)
    assert np.array_equal(again.segments[0].base_from_frame, view.segments[0].base_from_frame)
    assert len(view.cloud_m) <= MOST_POINTS and len(text) < 400_000


# --- in a browser -----------------------------------------------------------------------------------------------------

HTML = """<!doctype html><meta charset="utf-8"><body style="margin:0"><div id="view" style="height:600px"></div>
<script type="module">{script}
window.shown = mount(document.getElementById("view"), {plan});
window.painted = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {{
  const canvas = document.querySelector("canvas");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let drawn = 0, red = 0, sum = 0;
  for (let i = 0; i < data.length; i += 4) {{
    drawn += data[i + 3] > 0;
    red += data[i] > 180 && data[i + 1] < 60;
    sum = (sum * 31 + data[i] + data[i + 1] + data[i + 3]) % 1000003;
  }}
  done({{ drawn: drawn / (data.length / 4), red, sum, label: document.querySelector("output").textContent }});
}})));
</script>"""


@pytest.fixture(scope="module")
def page(view: PlanView, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    program = find_chromium()
    if program is None:
        pytest.skip("neither chromium-headless-shell nor chromium is installed")
    folder = tmp_path_factory.mktemp("plan")
    file = folder / "plan.html"
    script = "".join(line for one in SCRIPTS for line in one.read_text().splitlines(True) if "import {" not in line)
    file.write_text(HTML.format(script=script, plan=json.dumps(view.model_dump(mode="json"))))
    with chromium(program, folder / "profile") as page:
        page.open(file, 900)
        yield page


def test_the_canvas_shows_robot_and_cloud_and_complains_of_nothing(page: Page) -> None:
    painted = page.value("painted()")
    assert 0.05 < painted["drawn"] < 0.95 and painted["red"] > 200
    assert painted["label"] == "reach 0.0 / 1.0 s"
    assert page.errors == []


def test_the_slider_moves_the_arm_and_dragging_turns_the_view(page: Page) -> None:
    first = page.value("painted()")
    moved = page.value("shown.seek(0.7), painted()")
    assert moved["label"] == "reach 0.7 / 1.0 s" and moved["sum"] != first["sum"]
    page.value(
        """(() => { const c = document.querySelector("canvas"); c.setPointerCapture = () => {};
        const at = (type, x) => c.dispatchEvent(new PointerEvent(type, {pointerId: 1, clientX: x, clientY: 200}));
        at("pointerdown", 300); at("pointermove", 400); at("pointerup", 400); })()"""
    )
    assert page.value("painted()")["sum"] != moved["sum"] and page.errors == []


def test_play_runs_to_the_end_and_stops_there(page: Page) -> None:
    ended = """new Promise((done) => { shown.seek(0.8); shown.play();
        const look = () => document.querySelector("button").textContent === "Play" ? done(painted())
          : setTimeout(look, 20); look(); })"""
    assert page.value(ended)["label"] == "reach 1.0 / 1.0 s"
