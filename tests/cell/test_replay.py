"""Why did it decide so, and what if? A recorded pick, its pure stages run again in every way there is."""

from __future__ import annotations

import json
import queue
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from typer.testing import CliRunner

import perception.proposal
from bus import topics
from bus.codes import Code
from bus.commands import CellState
from bus.errors import ConfigError, NoReply, RecordingError, Refused
from bus.messages import Detections, Failure
from bus.rejection import Obstacle, Rejection
from bus.session import Bus
from cell.cli.commands import command_line
from cell.replay.compared_stages import STAGES
from cell.replay.folder import replay_folder
from cell.replay.replay import Replay, Request, replay
from cell.replay.republish import Payload, await_listener, payloads, republish, require_no_live_cell
from cell.replay.view import consequence, show_what_if, to_json, verdict, why_it_ends
from cell.terminal.printing import Printer
from config.load import load_station
from logs.differences import leaves
from logs.mcap.reader import CycleRecord, read_cycle
from perception.goal.drift import NOTHING_MOVED
from planning.robot import Robot

PICK = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"


@pytest.fixture(scope="module")
def record() -> CycleRecord:
    return read_cycle(PICK)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(load_station())


def test_the_same_code_decides_the_same(record: CycleRecord, robot: Robot) -> None:
    same = replay(record, Request(), lambda _: robot)
    assert verdict(same) == "equal" and not same.chained
    assert [stage.stage for stage in same.stages] == ["detect", "plan", "verify"]


def test_chained_it_decides_the_same_too(record: CycleRecord, robot: Robot) -> None:
    same = replay(record, Request(start="detect"), lambda _: robot)
    assert verdict(same) == "equal" and same.chained and same.not_reached == {}


def test_a_change_in_align_is_the_first_difference(
    record: CycleRecord, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = NOTHING_MOVED.observed_from_goal.copy()
    moved[0, 3] += 0.003
    monkeypatch.setattr(
        perception.proposal, "NOTHING_MOVED", NOTHING_MOVED.model_copy(update={"observed_from_goal": moved})
    )
    first = to_json(replay(record, Request(only="detect"), lambda _: robot))["first_difference"]
    assert (first["stage"], first["step"]) == ("detect", "align") and first["unit"] in ("mm", "m")


def test_a_changed_setting_shows_its_consequence_down_to_the_chosen_grasp(record: CycleRecord, robot: Robot) -> None:
    what_if = replay(record, Request(("perception.approach_clearance_m=0.002",)), lambda _: robot)
    assert what_if.chained and verdict(what_if) == "different"
    detected, planned = list(consequence(what_if))
    assert detected.startswith("detect: ") and " -> " in detected, detected
    assert planned.startswith("plan: grasp ") and "mm away" in planned
    assert what_if.not_reached == {"verify": "another plan was executed"}


def test_a_setting_that_ends_the_cycle_earlier_says_so_and_why(
    record: CycleRecord, robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    what_if = replay(record, Request(("scene.table.tolerance_deg=0.001",)), lambda _: robot)
    assert set(what_if.not_reached) == {"plan", "verify"} and "detect ends it" in what_if.not_reached["plan"]
    show_what_if(what_if, Printer())
    (failure,) = why_it_ends(what_if)
    assert "tilt" in failure and failure in capsys.readouterr().out, "the reason, not only its code"


def test_a_chain_may_begin_late_and_one_stage_may_be_run_alone(record: CycleRecord, robot: Robot) -> None:
    assert [one.stage for one in replay(record, Request(start="plan"), lambda _: robot).stages] == ["plan", "verify"]
    assert [one.stage for one in replay(record, Request(only="verify"), lambda _: robot).stages] == ["verify"]
    with pytest.raises(ConfigError, match="detect, plan, verify"):
        Request.of([], None, "execute")


def test_a_station_of_a_newer_version_is_refused_with_both_versions_and_a_wrong_override_is_not(
    record: CycleRecord, robot: Robot
) -> None:
    newer = {**record.station, "scene": {**record.station["scene"], "place_upside_down": True}}
    made = replace(record, station=newer, metadata={**record.metadata, "vlad-cell": "99.1.0"})
    with pytest.raises(ConfigError, match=r"'scene\.place_upside_down'.*recorded by version 99\.1\.0, and this is"):
        replay(made, Request(), lambda _: robot)
    theirs = replace(record, metadata={**record.metadata, "vlad-cell": "99.1.0"})
    with pytest.raises(ConfigError, match="max_width_m") as mistyped:
        replay(theirs, Request(("hand.max_width=0.05",)), lambda _: robot)
    assert "99.1.0" not in str(mistyped.value)


def test_a_recording_without_grasps_cannot_pass(record: CycleRecord, robot: Robot) -> None:
    detected = record.stages["detect"]
    assert isinstance(detected.result, Detections)
    bare = replace(record, stages={"capture": record.stages["capture"]})
    with pytest.raises(RecordingError, match="no stage that can be replayed"):
        replay(bare, Request(), lambda _: robot)
    nothing = Replay(bare, (), {}, chained=False)
    assert nothing.equal and verdict(nothing) == "empty"


@pytest.mark.parametrize("code", [Code.STOPPED, Code.CANCELLED, Code.DEADLINE, Code.NODE_LOST])
def test_what_ended_a_stage_from_outside_is_not_compared(record: CycleRecord, robot: Robot, code: Code) -> None:
    ended = record.stages["detect"].model_copy(update={"result": None, "failure": Failure(code=code, text="")})
    cut = replace(record, stages={"capture": record.stages["capture"], "detect": ended})
    with pytest.raises(RecordingError, match="no stage that can be replayed") as nothing:
        replay(cut, Request(), lambda _: robot)
    assert f"detect ({code})" in nothing.value.advice


FAILED = Failure(
    code=Code.COLLISION,
    text="",
    rejected=(Rejection(grasp=0, tilt_rad=0.0, code=Code.COLLISION, reason="", obstacle=Obstacle(
        part="hand", name="post", kind="seen", too_near_m=0.01, needed_m=0.004, touch_m=np.zeros(3),
        base_from_tcp=np.eye(4), opening_m=0.05, points_m=np.zeros((1, 3), np.float32))),),
)  # fmt: skip
"""The end of a plan with something in the way: its fields have rules, too."""


def test_every_rule_of_the_stage_table_names_a_field_that_exists(record: CycleRecord) -> None:
    for stage in STAGES:
        if stage.name not in record.stages:  # nobody was asked to approve it
            assert not stage.tolerances and not stage.steps
            continue
        result = record.stages[stage.name].result
        paths = [path for said in (result, FAILED) for path, _, _ in leaves("", said, said)]
        fields = [part for _, parts in stage.steps for part in parts]
        patterns = [re.compile(re.escape(rule).replace(r"\*", ".*")) for rule in stage.tolerances]
        assert all(any(pattern.fullmatch(path) for path in paths) for pattern in patterns), stage.name
        assert all(any(path.startswith(part) for path in paths) for part in fields), stage.name


def test_a_cycle_that_ended_before_the_stage_is_no_unreadable_one(tmp_path: Path, robot: Robot) -> None:
    for name, kept in (("whole.mcap", PICK), ("ended in plan.mcap", PICK.with_name("cycle-schema3.mcap"))):
        shutil.copy(kept, tmp_path / name)
    told: list[str] = []
    tally = replay_folder(tmp_path, Request(only="verify"), lambda path, said: told.append(f"{path.name} {said}"))
    assert told == ["ended in plan.mcap empty", "whole.mcap equal"] and tally.exit_code == 0


def test_a_folder_is_summed_up_and_what_cannot_be_read_is_named(tmp_path: Path, robot: Robot) -> None:
    shutil.copy(PICK, tmp_path / "one.mcap")
    (tmp_path / "two.mcap").write_bytes(PICK.read_bytes()[:9000])
    told: list[str] = []
    tally = replay_folder(tmp_path, Request(only="verify"), lambda path, said: told.append(f"{path.name} {said}"))
    assert told == ["one.mcap equal", "two.mcap unreadable"]
    assert tally.exit_code == 2 and list(tally.unreadable) == [str(tmp_path / "two.mcap")]
    (tmp_path / "two.mcap").unlink()
    said = CliRunner().invoke(command_line(), ["replay", str(tmp_path), "--only", "verify", "--json"])
    summary = json.loads(said.stdout)
    assert (said.exit_code, summary["cycles"], summary["equal"]) == (0, 1, 1)
    different = CliRunner().invoke(
        command_line(), ["replay", str(tmp_path), "--set", "verify.min_width_m=0.079", "--only", "verify"]
    )
    assert different.exit_code == 1 and "first in verify/verify, held" in different.stdout


# --- on the bus again -------------------------------------------------------------------------------------------------


def test_without_a_subscriber_it_waits_then_says_that_nothing_was_published(endpoint: str) -> None:
    again = ["replay", str(PICK), "--publish", "--endpoint", endpoint, "--rate", "1e6"]
    in_vain = CliRunner().invoke(command_line(), [*again, "--wait-s", "0.05"])
    assert isinstance(in_vain.exception, NoReply) and in_vain.exception.exit_code == 4
    assert "waiting up to 0.05 s for a subscriber" in in_vain.stderr
    at_once = CliRunner().invoke(command_line(), [*again, "--wait-s", "0"])
    assert at_once.exit_code == 0 and at_once.stderr.splitlines()[-1].endswith("payloads published")


def test_a_replay_travels_byte_for_byte_below_a_key_of_its_own(endpoint: str) -> None:
    heard: queue.SimpleQueue[tuple[str, str, bytes]] = queue.SimpleQueue()
    said = list(payloads(PICK))[:40]

    def hear(sample: zenoh.Sample) -> None:
        heard.put((str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes()))

    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
    with Bus.listen("elsewhere", endpoint) as bus:
        with pytest.raises(NoReply, match="Nothing was published: nobody subscribed"):
            await_listener(bus, "412", 0.01)
        await_listener(bus, "412", 0.0)  # for nobody
        listener = zenoh.open(config)
        listener.declare_subscriber("replay/**", hear)
        await_listener(bus, "412", 5.0)
        sent = list(republish(bus, "412", said, rate=1e6))
        assert sent == said
        for payload in said:
            assert heard.get(timeout=60) == (f"replay/412/{payload.key}", payload.encoding, payload.data)
        listener.close()  # type: ignore[no-untyped-call]


def test_it_keeps_the_recorded_pace(endpoint: str) -> None:
    said = [Payload(log_time_ns, "state", "application/json", b"{}") for log_time_ns in (0, 50_000_000, 200_000_000)]
    slept: list[float] = []
    with Bus.listen("elsewhere", endpoint) as bus:
        times = [payload.log_time_ns for payload in republish(bus, "412", said, 2.0, slept.append)]
    assert times == [0, 50_000_000, 200_000_000]
    assert all(0 < pause_s <= 0.05 for pause_s in slept) and slept


def test_it_is_refused_while_its_cell_is_live(endpoint: str) -> None:
    station = load_station(None, [f"bus.endpoint={endpoint}"])
    require_no_live_cell(station)
    state = CellState(state="Idle", stage="", cycle_id="", since_ns=1, available=(), reason="")
    with Bus.listen(station.cell_id, endpoint) as live:
        live.answer(topics.STATE_NOW, lambda _payload, _fields: state, worker="state")
        with pytest.raises(Refused, match="is live") as refusal:
            require_no_live_cell(station)
    assert refusal.value.code == "LIVE_CELL"
