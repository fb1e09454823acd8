"""The doctor's checks against real sockets, folders and processes: what is well, what is to fix, in what words."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from importlib.metadata import requires
from pathlib import Path

import pytest

from cell.build import running_cell
from cell.doctor import arm, catalogue, judging, kernel, machine, network, reach
from cell.doctor.examine import CHECKS, examine
from cell.doctor.finding import Finding, Verdict
from config.load import DEFAULT_STATION, load_station
from config.schema import Station
from logs.catalogue import open_catalogue
from logs.catalogue.store import CATALOGUE

FOLDER = DEFAULT_STATION.parent
PICK = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
Run = Callable[..., subprocess.CompletedProcess[str]]
HERE = "127.71.72.73"
"""An address of this machine that no other test listens on."""


def simulated(*overrides: str) -> Station:
    return load_station(None, overrides)


def lab(*overrides: str) -> Station:
    return load_station(FOLDER / "lab.toml", overrides)


def lab_here(*overrides: str) -> Station:
    """The lab, with its devices at `HERE`."""
    here = [f"{device}.address={HERE}" for device in ("fr3", "panda_hand", "femto_mega")]
    return lab(*here, *overrides)


def is_ok(finding: Finding, *words: str) -> None:
    assert finding.verdict is Verdict.OK and not finding.advice, finding
    assert all(word in finding.found for word in words), finding


def is_to_fix(finding: Finding, *words: str) -> None:
    assert finding.verdict is Verdict.FIX and finding.advice, finding
    assert all(word in f"{finding.found} {finding.advice}" for word in words), finding


def is_skipped(finding: Finding, *words: str) -> None:
    assert finding.verdict is Verdict.SKIP and not finding.advice, finding
    assert all(word in finding.found for word in words), finding


@pytest.fixture
def listen() -> Iterator[Callable[[], socket.socket]]:
    """Opens a listening socket at `HERE`."""
    with ExitStack() as stack:

        def anew() -> socket.socket:
            listener = stack.enter_context(socket.create_server((HERE, 0)))
            listener.settimeout(5)
            return listener

        yield anew


def port_of(listener: socket.socket) -> int:
    return int(listener.getsockname()[1])


@pytest.fixture
def routes(tmp_path: Path) -> Path:
    """A kernel's routes: 172.16.0.0/24 on eth1 itself, everything else through a router on eth0."""
    file = tmp_path / "route"
    file.write_text(
        "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"
        "eth0 00000000 0101A8C0 0003 0 0 0 00000000 0 0 0\n"
        "eth1 000010AC 00000000 0001 0 0 0 00FFFFFF 0 0 0\n"
    )
    return file


def test_it_says_what_cannot_be_noticed_while_the_weight_of_one_object_is_not_known() -> None:
    is_skipped(judging.double_picks(lab()), "verify.max_load_n", "not noticed")
    is_ok(judging.double_picks(lab("verify.max_load_n=1.5")), "1.5 N")
    is_skipped(judging.double_picks(lab("verify.max_load_n=1.5", 'verify.several_by=["place"]')))


# --- the machine ------------------------------------------------------------------------------------------------------


def test_every_package_this_project_requires_is_counted() -> None:
    required = [one for one in requires("vlad-cell") or [] if "extra ==" not in one]
    is_ok(machine.packages(simulated()), "Python 3.", "mujoco", f"all {len(required)} packages")


def test_a_distribution_that_is_not_installed() -> None:
    is_to_fix(machine.packages(simulated(), "no-such-distribution"), "not installed", "./setup.sh")


def test_drivers_that_are_there_missing_or_unknown() -> None:
    is_ok(machine.drivers(simulated()), "sim")
    absent = {"fr3": ("no_such_sdk", "fr3", (3, 13)), "femto_mega": ("no_such_camera", "femto", None)}
    is_to_fix(
        machine.drivers(lab(), absent, (3, 12)), "no_such_camera, no_such_sdk", "uv pip install 'vlad-cell[femto,fr3]'"
    )
    is_to_fix(machine.drivers(lab(), absent, (3, 13)), "no_such_sdk needs Python 3.12 or older")
    is_to_fix(machine.drivers(simulated("nodes.sim.driver=warp")), "No such driver: warp", "sim")


def test_values_of_another_cell_are_to_fix_before_a_real_arm_moves() -> None:
    found = judging.values(lab(), FOLDER / "lab.toml")
    is_to_fix(found, "16 lines still hold values of another cell", "take the word CHANGE or DECIDE out of the line")
    assert judging.values(simulated(), FOLDER / "new" / "simulated.toml").verdict is Verdict.SKIP
    is_ok(judging.values(simulated(), FOLDER / "sim.toml"), "No line of", "is marked")


def test_rendering_is_tried_where_the_station_simulates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_DRAW_S", 120.0)  # on a busy machine a new process imports MuJoCo for long
    is_ok(machine.rendering(simulated()), "64 x 64")
    is_skipped(machine.rendering(lab()), "simulated")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "99")
    is_to_fix(machine.rendering(simulated()), "without a screen", "./setup.sh")


def test_a_catalogue_of_somebody_else_is_not_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / CATALOGUE).touch()
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # also for root, whom no rights keep out
    is_to_fix(
        catalogue.catalogue(simulated(f"recording.folder={tmp_path}")), "You may not read", "the right to read it"
    )


def test_the_disk_is_measured_where_the_recordings_will_be(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "yet" / "there"
    is_ok(machine.disk(simulated(f"recording.folder={folder}")), "GB free", str(folder))
    assert not folder.exists() and not any(tmp_path.iterdir()), "the doctor leaves nothing behind"
    is_to_fix(machine.disk(simulated(f"recording.folder={folder}", "recording.min_free_mb=1e12")), "min_free_mb")


def test_a_folder_nobody_can_write_to() -> None:
    is_to_fix(machine.disk(simulated("recording.folder=/proc/recordings")), "cannot be written", "recording.folder")


def test_the_catalogue_is_missing_up_to_date_stale_of_another_version_or_damaged(tmp_path: Path) -> None:
    station = simulated(f"recording.folder={tmp_path}")
    is_skipped(catalogue.catalogue(station), "nothing for it to list")
    shutil.copy(PICK, tmp_path / "one.mcap")
    is_to_fix(catalogue.catalogue(station), "it is missing", "reads 1 recordings")
    with open_catalogue(tmp_path):
        pass
    held = sorted(path.name for path in tmp_path.iterdir())
    is_ok(catalogue.catalogue(station), "1 cycles")
    assert sorted(path.name for path in tmp_path.iterdir()) == held, "the doctor leaves nothing behind"
    (tmp_path / "one.mcap").rename(tmp_path / "other.mcap")
    is_to_fix(catalogue.catalogue(station), "1 recordings are not in it", "1 rows have no recording", "rebuild")
    with closing(sqlite3.connect(tmp_path / CATALOGUE)) as connection:
        connection.execute("PRAGMA user_version = 7")
    is_to_fix(catalogue.catalogue(station), "another version")
    (tmp_path / CATALOGUE).write_bytes(b"no database, and of more than sixteen bytes")
    is_to_fix(catalogue.catalogue(station), "damaged", "`cell catalogue rebuild`")


def test_the_clock_matters_to_real_devices() -> None:
    is_ok(machine.clock(lab(), lambda: (True, 0.012)), "12 ms")
    is_to_fix(machine.clock(lab(), lambda: (False, 16.0)), "timedatectl")
    is_ok(machine.clock(simulated(), lambda: (False, 16.0)), "only real devices")
    in_step, error_s = machine._kernel_clock()
    assert in_step in (True, False) and error_s >= 0


# --- the kernel -------------------------------------------------------------------------------------------------------


def test_the_real_time_kernel_says_so_itself(tmp_path: Path) -> None:
    flag = tmp_path / "realtime"
    is_to_fix(kernel.realtime(lab(), flag), "not a PREEMPT_RT kernel", "linux-image-rt")
    flag.write_text("1\n")
    is_ok(kernel.realtime(lab(), flag))


def test_rights_of_the_control_loop() -> None:
    is_ok(kernel.priority(lab(), lambda: True))
    is_to_fix(kernel.priority(lab(), lambda: False), "SCHED_FIFO", "limits.conf")
    is_ok(kernel.memory(lab(), lambda: float("inf")), "Without limit")
    is_ok(kernel.memory(lab(), lambda: 2e8), "200 MB")
    is_to_fix(kernel.memory(lab(), lambda: 8e6), "8 MB", "limits.conf")


def test_asking_for_a_priority_leaves_none_behind() -> None:
    before = os.sched_getscheduler(0)
    assert kernel._can_be_fifo() in (True, False)
    assert os.sched_getscheduler(0) == before


def test_every_core_runs_at_full_speed_or_one_is_named(tmp_path: Path) -> None:
    is_skipped(kernel.governor(lab(), tmp_path))
    for cpu, governor in (("cpu0", "performance"), ("cpu1", "performance")):
        (tmp_path / cpu / "cpufreq").mkdir(parents=True)
        (tmp_path / cpu / "cpufreq" / "scaling_governor").write_text(f"{governor}\n")
    is_ok(kernel.governor(lab(), tmp_path), "performance")
    (tmp_path / "cpu1" / "cpufreq" / "scaling_governor").write_text("powersave\n")
    is_to_fix(kernel.governor(lab(), tmp_path), "powersave", "cpupower")


@pytest.mark.parametrize("check", [kernel.realtime, kernel.priority, kernel.memory, kernel.governor])
def test_nothing_is_asked_of_the_kernel_without_the_arms_loop(check: Callable[[Station], Finding]) -> None:
    is_skipped(check(simulated()), "fr3")
    is_skipped(check(lab("fr3.realtime=ignore")), "ignore")


# --- the arm, the hand, the camera ------------------------------------------------------------------------------------


def test_a_simulator_of_the_arm_is_seen_without_being_called(listen: Callable[[], socket.socket]) -> None:
    listener = listen()
    is_ok(arm.control(lab_here(), port_of(listener)), HERE, "listens")
    listener.settimeout(0.05)
    with pytest.raises(TimeoutError):
        listener.accept()


def test_an_arm_that_is_in_use_is_left_alone(listen: Callable[[], socket.socket]) -> None:
    listener = listen()
    with socket.create_connection((HERE, port_of(listener))), listener.accept()[0]:
        is_ok(arm.control(lab_here(), port_of(listener)), "is connected")


def test_nobody_at_the_arms_or_the_hands_port(endpoint: str) -> None:
    port = int(endpoint.rpartition(":")[2])
    for check in (arm.control, arm.hand):
        is_to_fix(check(lab_here(), port), f"port {port}: nobody listens")


def test_a_real_arm_sees_one_connection_closed_at_once(
    listen: Callable[[], socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = listen()
    monkeypatch.setattr(arm, "is_listening", None)  # not asked
    monkeypatch.setattr(arm, "is_this_machine", lambda ip: False)
    monkeypatch.setattr(arm, "way_to", lambda ip: ("eth1", False))
    port = port_of(listener)
    is_ok(arm.control(lab_here(), port), "answers")
    connection, _ = listener.accept()
    with connection:
        assert connection.recv(1) == b"", "closed, and nothing was said"
    listener.close()
    is_to_fix(arm.control(lab_here(), port), "refuses", "unlock the joints", "Activate FCI")
    is_to_fix(arm.hand(lab_here(), port), "refuses", "End Effector")


def test_the_way_to_the_arm(routes: Path) -> None:
    is_ok(arm.network(lab(), routes), "172.16.0.2", "eth1")
    is_to_fix(arm.network(lab("fr3.address=10.1.2.3"), routes), "router on eth0", "10.1.2.0/24")
    is_ok(arm.network(lab_here(), routes), "simulator")
    routes.write_text(routes.read_text().splitlines()[0] + "\n")
    is_to_fix(arm.network(lab(), routes), "No network")


def test_an_arm_behind_a_router_is_not_asked(routes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm, "way_to", lambda ip: network.way_to(ip, routes))
    monkeypatch.setattr(arm, "obstacle", None)
    for check in (arm.control, arm.latency):
        is_skipped(check(lab("fr3.address=10.1.2.3")), "not on a network of this machine")


def test_round_trips_are_timed(listen: Callable[[], socket.socket], monkeypatch: pytest.MonkeyPatch) -> None:
    is_skipped(arm.latency(lab_here()), "No network")
    monkeypatch.setattr(arm, "is_this_machine", lambda ip: False)
    monkeypatch.setattr(arm, "way_to", lambda ip: ("eth1", False))
    port = port_of(listen())
    is_ok(arm.latency(lab_here(), port, slowest_s=5.0), "20 round trips", "median")
    is_to_fix(arm.latency(lab_here(), port, slowest_s=1e-9), "longest", "cable of its own")


def test_the_camera_answers_or_refuses(listen: Callable[[], socket.socket]) -> None:
    listener = listen()
    port = port_of(listener)
    is_ok(reach.camera(lab_here(), port), HERE, "answers")
    listener.close()
    is_to_fix(reach.camera(lab_here(), port), "refuses", "femto_mega.address")
    is_skipped(reach.camera(lab("femto_mega={serial='CL2X'}")), "serial number")
    is_skipped(reach.camera(simulated()), "femto_mega")


def test_what_answers_beyond_a_router_may_not_be_the_camera(
    listen: Callable[[], socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reach, "way_to", lambda ip: ("eth0", True))
    is_skipped(reach.camera(lab_here(), port_of(listen())), HERE, "beyond the router on eth0")


def test_a_port_that_accepts_too_slowly_does_not_hold_the_doctor_up() -> None:
    with socket.socket() as listener, ExitStack() as stack:
        listener.bind((HERE, 0))
        listener.listen(0)
        port = port_of(listener)
        for _ in range(4):  # the queue of those not yet accepted is full
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex((HERE, port))
        station = load_station(FOLDER / "openai.toml", [f"perception.hosted.base_url=http://{HERE}:{port}/v1"])
        started_s = time.monotonic()
        is_to_fix(reach.model_server(station, {}), "does not answer within 1 s")
        assert time.monotonic() - started_s < 30, "the kernel itself would try for two minutes"


# --- the hosted model -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "variable"), [("openai", "OPENAI_API_KEY"), ("gemini", "GEMINI_API_KEY")])
def test_a_key_is_looked_for_and_never_shown(model: str, variable: str) -> None:
    station = load_station(FOLDER / f"{model}.toml")
    is_to_fix(reach.model_key(station, {}), variable, "export")
    finding = reach.model_key(station, {variable: "sk-secret"})
    is_ok(finding, variable, station.perception.hosted.image_model)
    assert "sk-secret" not in json.dumps(finding.to_json())
    is_to_fix(reach.model_key(simulated(f"perception.model={model}"), {}), "text_model", f"config/{model}.toml")
    is_skipped(reach.model_key(simulated()), "geometric")


def test_the_models_server_is_called_on(listen: Callable[[], socket.socket]) -> None:
    listener = listen()
    port = port_of(listener)
    station = load_station(FOLDER / "openai.toml", [f"perception.hosted.base_url=http://{HERE}:{port}/v1"])
    is_ok(reach.model_server(station, {}), HERE, str(port))
    is_skipped(reach.model_server(station, {"http": "http://proxy:3128"}), "proxy")
    listener.close()
    is_to_fix(reach.model_server(station, {}), "refuses", "base_url")


# --- the bus ----------------------------------------------------------------------------------------------------------


def test_a_free_endpoint_and_one_that_another_program_has(listen: Callable[[], socket.socket]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        station = simulated(f"bus.endpoint=tcp/127.0.0.1:{stranger.getsockname()[1]}")
        started_s = time.monotonic()
        is_to_fix(reach.bus(station), "no cell 'sim' answers", "bus.endpoint")
        assert time.monotonic() - started_s < 10
    is_ok(reach.bus(station), "free")


@pytest.fixture
def station(options: list[str]) -> Iterator[Station]:
    """Of a running cell, Stopped."""
    station = simulated(*options[1::2])
    with running_cell(station, lambda topic, message: None):
        yield station


def test_a_running_cell_and_the_nodes_it_waits_for(station: Station) -> None:
    is_ok(reach.bus(station), "is running", "Stopped")
    is_skipped(reach.nodes(station))
    own = {"driver": "sim", "serves": ["camera", "arm", "hand"], "run": "elsewhere"}
    elsewhere = station.model_copy(update={"nodes": {"sim": station.nodes["sim"].model_copy(update=own)}})
    is_ok(reach.nodes(elsewhere), "Up: sim")
    other = station.model_copy(update={"nodes": {"lamp": station.nodes["sim"].model_copy(update=own)}})
    is_to_fix(reach.nodes(other), "Not up: lamp", "cell node lamp")


def test_nodes_elsewhere_wait_for_a_cell(endpoint: str) -> None:
    is_skipped(reach.nodes(simulated("nodes.sim.run=elsewhere", f"bus.endpoint={endpoint}")), "cell node")


# --- the command ------------------------------------------------------------------------------------------------------


def test_nothing_to_fix_is_exit_0(in_process: Run, options: list[str]) -> None:
    done = in_process("doctor", *options)
    assert done.returncode == 0 and "nothing to fix" in done.stdout, done.stdout
    (unneeded,) = [line for line in done.stdout.splitlines() if line.startswith("not needed by this station: ")]
    named = unneeded.partition(": ")[2].split(", ")
    assert {"arm network", "hand", "real-time kernel"} <= set(named)
    shown = [line for line in done.stdout.splitlines() if line.split()[0] in ("ok", "skip")]
    assert len(shown) + len(named) == len(CHECKS) + 1


def test_something_to_fix_is_exit_1_and_json_is_one_object_a_line(in_process: Run, options: list[str]) -> None:
    done = in_process("doctor", *options, "--json", "--set", "recording.min_free_mb=1e12")
    assert done.returncode == 1
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(said) == len(CHECKS) + 1 and all(set(one) == {"name", "verdict", "found", "advice"} for one in said)
    (disk,) = [one for one in said if one["verdict"] == "fix"]
    assert disk["name"] == "disk" and disk["advice"]


def test_a_wrong_station_file_is_a_usage_error(in_process: Run) -> None:
    done = in_process("doctor", "--config", "absent.toml")
    assert done.returncode == 2 and "absent.toml" in done.stderr


def test_findings_come_one_by_one_and_an_absent_lab_takes_little_time(endpoint: str) -> None:
    station = lab_here(f"bus.endpoint={endpoint}")
    started_s = time.monotonic()
    findings = examine(station, FOLDER / "sim.toml")
    assert next(findings).name == "packages" and time.monotonic() - started_s < 10
    assert len({one.name for one in findings}) == len(CHECKS)
    assert time.monotonic() - started_s < 30
