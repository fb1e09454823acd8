"""`cell export lerobot`: what is written is what was recorded, read back with pyarrow and av alone."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import CatalogueError, ConfigError, RecordingError
from bus.messages import Motion
from bus.trajectory import TICK_S
from logs.catalogue import open_catalogue
from logs.export import Done, Selection, export_lerobot, select
from logs.export.clock import EpisodeClock, Played, played
from logs.export.features import CAMERAS, FEATURES, INDICES
from logs.export.rolling import Limits
from logs.export.signals import STAGES
from logs.export.statistics import KEYS, of_numbers, pooled
from logs.export.video import depth_m
from logs.mcap.reader import STAGE_TOPICS, CycleRecord, read_cycle, read_with_messages

av = pytest.importorskip("av")
parquet = pytest.importorskip("pyarrow.parquet")

GOLDEN = Path(__file__).parents[1] / "golden"
PICKED, PICKED_TOO, BLOCKED = "cycle-schema4", "cycle-schema2", "cycle-schema3"
FPS = 10
COLOR, DEPTH = CAMERAS


def all_of(paths: Any, _total: int) -> Any:
    return paths


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two picks, and between them a cycle whose plan failed."""
    folder = tmp_path_factory.mktemp("recordings")
    for number, name in enumerate((PICKED, BLOCKED, PICKED_TOO)):
        shutil.copy(GOLDEN / f"{name}.mcap", folder / f"{number}-{name}.mcap")
    return folder


def chosen(folder: Path, where: str = "") -> Selection:
    with open_catalogue(folder) as catalogue:
        return select(catalogue, where)


@pytest.fixture(scope="module")
def exported(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """All of them, in as few files as possible."""
    target = tmp_path_factory.mktemp("exported") / "dataset"
    return target, export_lerobot(chosen(recordings), target, all_of, fps=FPS)


class Dataset:
    """A data set as any reader of its layout sees it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.info: dict[str, Any] = json.loads((root / "meta/info.json").read_text())
        self.stats: dict[str, dict[str, Any]] = json.loads((root / "meta/stats.json").read_text())
        tables = [parquet.read_table(path) for path in sorted((root / "meta/episodes").rglob("*.parquet"))]
        self.episodes: list[dict[str, Any]] = [row for table in tables for row in table.to_pylist()]

    def frames(self, episode: int) -> dict[str, np.ndarray]:
        """The columns of one episode's rows."""
        row = self.episodes[episode]
        path = self.info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        columns = parquet.read_table(self.root / path, filters=[("episode_index", "=", episode)]).to_pydict()
        return {name: np.array(values) for name, values in columns.items()}

    def video(self, episode: int, key: str) -> Iterator[np.ndarray]:
        """The pictures of one episode, found by their times, as LeRobot does."""
        row, count = self.episodes[episode], self.episodes[episode]["length"]
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        first = row[f"videos/{key}/from_timestamp"]
        assert row[f"videos/{key}/to_timestamp"] == pytest.approx(first + count / FPS)
        wanted = {round((first + number / FPS) * 1000) for number in range(count)}
        with av.open(str(self.root / self.info["video_path"].format(video_key=key, **place))) as file:
            for frame in file.decode(video=0):
                if round(float(frame.pts * frame.time_base) * 1000) in wanted:
                    yield frame.to_ndarray(format=CAMERAS[key].form.given)


def motions_of(path: Path) -> tuple[CycleRecord, list[Played]]:
    record, content = read_with_messages(path)
    return record, list(played(content))


# --- layout -----------------------------------------------------------------------------------------------------------


def test_the_layout_is_that_of_version_3(exported: tuple[Path, Done]) -> None:
    target, done = exported
    dataset = Dataset(target)
    info = dataset.info
    assert done.counts == {"episodes": 3, "frames": info["total_frames"], "tasks": 1} and not done.left_out
    assert (info["codebase_version"], info["fps"], info["splits"]) == ("v3.0", FPS, {"train": "0:3"})
    assert set(info["features"]) == {*FEATURES, *INDICES, *CAMERAS} == set(dataset.stats)
    assert info["features"][COLOR]["shape"] == [360, 640, 3] and info["features"][DEPTH]["info"]["is_depth_map"]
    assert info["features"]["observation.state"]["shape"] == [8] and info["features"]["stage_index"]["shape"] == [1]
    files = {str(path.relative_to(target)) for path in target.rglob("*") if path.is_file()}
    assert files == {
        "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet",
        "data/chunk-000/file-000.parquet",
        f"videos/{COLOR}/chunk-000/file-000.mp4", f"videos/{DEPTH}/chunk-000/file-000.mp4",
    }  # fmt: skip
    schema = parquet.read_schema(target / "data/chunk-000/file-000.parquet")
    assert str(schema.field("action").type) == "fixed_size_list<element: float>[8]"
    tasks = parquet.read_schema(target / "meta/tasks.parquet")
    assert json.loads(tasks.metadata[b"pandas"])["index_columns"] == ["task"], "pandas reads the text as the index"


def test_episodes_follow_each_other_and_times_lie_on_the_grid(exported: tuple[Path, Done]) -> None:
    dataset, first, first_s = Dataset(exported[0]), 0, 0.0
    for number, row in enumerate(dataset.episodes):
        frames = dataset.frames(number)
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (first, first + row["length"])
        assert row[f"videos/{COLOR}/from_timestamp"] == pytest.approx(first_s)
        assert (frames["index"] == first + np.arange(row["length"])).all()
        assert (frames["timestamp"] == (np.arange(row["length"]) / FPS).astype(np.float32)).all()
        assert not frames["next.done"][:-1].any() and frames["next.done"][-1]
        assert row["tasks"] == ["pick the object"] and set(frames["task_index"]) == {0}
        first, first_s = row["dataset_to_index"], row[f"videos/{COLOR}/to_timestamp"]
    assert first == dataset.info["total_frames"]


def test_full_files_are_followed_by_others(recordings: Path, exported: tuple[Path, Done], tmp_path: Path) -> None:
    limits = Limits(data_bytes=1, video_bytes=1)
    export_lerobot(chosen(recordings), tmp_path / "small", all_of, fps=FPS, limits=limits)
    small, whole = Dataset(tmp_path / "small"), Dataset(exported[0])
    for number, row in enumerate(small.episodes):
        assert (row["data/file_index"], row["meta/episodes/file_index"]) == (number, number)
        assert (row[f"videos/{DEPTH}/file_index"], row[f"videos/{DEPTH}/from_timestamp"]) == (number, 0.0)
        frames = small.frames(number)
        assert all((frames[name] == values).all() for name, values in whole.frames(number).items())
        for one, other in zip(small.video(number, COLOR), whole.video(number, COLOR), strict=True):
            assert (one == other).all()


def test_a_video_ends_before_its_times_are_too_coarse_for_the_reader(recordings: Path, tmp_path: Path) -> None:
    export_lerobot(chosen(recordings), tmp_path / "short", all_of, fps=FPS, limits=Limits(video_s=7.0))
    rows = Dataset(tmp_path / "short").episodes
    assert [row[f"videos/{COLOR}/file_index"] for row in rows] == [0, 0, 1], "6.0 s, 7.5 s, then full"
    assert np.spacing(np.float32(Limits().video_s)) < 1e-4, "the reader's tolerance"


def test_statistics_are_those_of_all_frames(exported: tuple[Path, Done]) -> None:
    dataset = Dataset(exported[0])
    rows = np.concatenate([dataset.frames(number)["action"] for number in range(3)])
    stats = dataset.stats["action"]
    assert set(stats) == set(KEYS) and stats["count"] == [len(rows)]
    for name, value in (("min", rows.min(0)), ("max", rows.max(0)), ("mean", rows.mean(0)), ("std", rows.std(0))):
        assert stats[name] == pytest.approx(value, abs=1e-5), name
    assert np.shape(dataset.stats[COLOR]["mean"]) == (3, 1, 1) and 0 < np.min(dataset.stats[COLOR]["mean"]) < 1
    assert dataset.episodes[0]["stats/action/mean"] == pytest.approx(dataset.frames(0)["action"].mean(0), abs=1e-5)


def test_statistics_of_parts_are_pooled_by_their_counts() -> None:
    values = np.random.default_rng(1).normal(size=(50, 3))
    whole, parts = of_numbers(values), pooled([of_numbers(values[:10]), of_numbers(values[10:])])
    for name in ("min", "max", "mean", "std", "count"):
        assert parts[name] == pytest.approx(whole[name])
    assert (parts["q01"] < parts["q50"]).all() and (parts["q50"] < parts["q99"]).all()


# --- content ----------------------------------------------------------------------------------------------------------


def test_states_and_actions_are_what_was_measured_and_commanded(exported: tuple[Path, Done]) -> None:
    frames = Dataset(exported[0]).frames(0)
    record, motions = motions_of(GOLDEN / f"{PICKED}.mcap")
    clock = EpisodeClock(record.looks[0].frame.stamp_ns, motions)
    reach = motions[0]
    began_s = float(clock.time_s(reach.began_ns))
    inside = [k for k in range(len(frames["index"]) - 1) if began_s < k / FPS < began_s + reach.lasted_s - 1 / FPS]
    assert len(inside) > 8, "a motion of 1.2 s"
    for k in inside:
        motion_s = k / FPS - began_s
        measured = [np.interp(motion_s, reach.motion.t_s, column) for column in reach.motion.q_rad.T]
        assert frames["observation.state"][k, :7] == pytest.approx(measured, abs=1e-5)
        told = reach.motion.commanded_q_rad[int((motion_s + 1 / FPS) / TICK_S) - 1]
        assert frames["action"][k, :7] == pytest.approx(told, abs=2e-3), "at the time of the next frame, one tick or so"
    swept = np.abs(np.diff(frames["observation.state"][inside][:, :7], axis=0)).max() * FPS
    assert swept <= np.abs(reach.motion.dq_rad_s).max() + 1e-3, "as fast as the arm was, not as the simulation was"


def test_the_hand_is_told_its_width_and_then_to_press(exported: tuple[Path, Done]) -> None:
    frames = Dataset(exported[0]).frames(0)
    record = read_cycle(GOLDEN / f"{PICKED}.mcap")
    told, measured = frames["action"][:, 7], frames["observation.state"][:, 7]
    done: dict[str, Any] = {name: stage.result for name, stage in record.stages.items()}
    opening = done["detect"].grasps[done["plan"].grasp].opening_m
    held = measured[(told == 0) & (np.roll(told, 1) == 0)][3:]
    assert np.isclose(told, opening, atol=1e-4).any() and (told == 0).sum() > 20
    assert held == pytest.approx(done["execute"].grasped.width_m, abs=2e-3)
    assert (frames["hand_utc_ns"] <= frames["utc_ns"] + 10**6).all(), "the last one, none of the future"


@pytest.mark.parametrize(("episode", "name"), [(0, PICKED), (1, BLOCKED)])
def test_each_frame_shows_the_last_picture_with_its_age(episode: int, name: str, exported: tuple[Path, Done]) -> None:
    dataset = Dataset(exported[0])
    frames, record = dataset.frames(episode), read_cycle(GOLDEN / f"{name}.mcap")
    looks = {one.frame.stamp_ns: one for one in (*record.looks, record.after) if one is not None}
    both = zip(dataset.video(episode, COLOR), dataset.video(episode, DEPTH), strict=True)
    for k, (color, depth) in enumerate(both):
        look = looks[int(frames["camera_utc_ns"][k])]
        assert np.abs(color.astype(int) - look.frame.color).mean() < 3, "within what the codec loses"
        error_m = np.abs(depth_m(depth) - look.frame.depth_m)
        assert np.nanmax(error_m) < 2e-3 and (np.isnan(error_m) == np.isnan(look.frame.depth_m)).all()
        assert frames["camera_pose"][k] == pytest.approx(look.view.base_from_color.ravel(), abs=1e-5)
    assert k + 1 == len(frames["index"]) and {*frames["camera_utc_ns"].tolist()} == {*looks}
    renewed = np.flatnonzero(np.diff(frames["camera_utc_ns"])) + 1
    assert (frames["camera_age_s"][[0, *renewed]] < 1 / FPS).all(), "a new picture is new"
    assert np.delete(np.diff(frames["camera_age_s"]), renewed - 1) == pytest.approx(1 / FPS, abs=1e-4)


def test_an_episode_says_how_it_ended(exported: tuple[Path, Done]) -> None:
    dataset = Dataset(exported[0])
    picked, blocked, _ = dataset.episodes
    assert (picked["result"], picked["held"], picked["executed"]) == ("SUCCESS", True, True)
    assert (blocked["result"], blocked["code"], blocked["held"]) == ("FAILED", "COLLISION", None)
    assert blocked["base_from_tcp"] is None and len(picked["base_from_tcp"]) == 16 and picked["load_n"] > 0.3
    assert dataset.frames(0)["next.success"][-1] and not dataset.frames(1)["next.success"].any()
    assert {1, 2, 3, 4, 6} <= set(dataset.frames(0)["stage_index"].tolist()) <= {*range(7)}
    assert json.loads(picked["color_camera"])["width"] == 640


def test_every_stage_of_a_cycle_has_an_index_also_the_one_that_waited_for_approval() -> None:
    assert {topic.key.removeprefix("cycle/") for topic in STAGE_TOPICS} == {*STAGES} - {"between"}


def test_the_same_recordings_give_the_same_files(recordings: Path, exported: tuple[Path, Done], tmp_path: Path) -> None:
    export_lerobot(chosen(recordings), tmp_path / "again", all_of, fps=FPS)
    for path in (path for path in exported[0].rglob("*") if path.is_file()):
        assert (tmp_path / "again" / path.relative_to(exported[0])).read_bytes() == path.read_bytes(), path


def test_time_is_the_arms_while_it_moves_and_the_walls_between() -> None:
    rest = np.zeros((3000, 7))
    motion = Motion(finished=True, commanded_q_rad=rest, t_s=np.zeros(1), q_rad=rest[:1], dq_rad_s=rest[:1],
                    tau_ext_nm=rest[:1])  # fmt: skip
    clock = EpisodeClock(10**9, [Played(2 * 10**9, 2_500_000_000, motion)])
    walls = [10**9, 2 * 10**9, 2_250_000_000, 2_500_000_000, 4 * 10**9]
    assert clock.time_s(walls).tolist() == [0.0, 1.0, 2.5, 4.0, 5.5], "3 s of motion in half a second"
    assert clock.utc_ns(clock.time_s(walls)).tolist() == walls
    assert clock.time_s(0) == -1.0


# --- which, and what goes wrong ---------------------------------------------------------------------------------------


def test_a_condition_chooses_the_cycles(recordings: Path, tmp_path: Path) -> None:
    done = export_lerobot(chosen(recordings, "code = 'COLLISION'"), tmp_path / "failed", all_of)
    assert done.counts["episodes"] == 1
    assert [path.name for path in chosen(recordings, "held -- only these").paths] == [
        f"0-{PICKED}.mcap", f"2-{PICKED_TOO}.mcap"
    ]  # fmt: skip
    with pytest.raises(RecordingError, match="no recorded cycle where code = 'DROPPED'"):
        chosen(recordings, "code = 'DROPPED'")
    with pytest.raises(CatalogueError, match="cannot be answered"):
        chosen(recordings, "no_such_column = 1")


def test_what_cannot_be_read_is_left_out_and_named(recordings: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    shutil.copytree(recordings, folder)
    whole = (folder / f"0-{PICKED}.mcap").read_bytes()
    (folder / f"0-{PICKED}.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / "3-open.mcap.part").write_bytes(whole[:1000])
    done = export_lerobot(
        chosen(folder),
        tmp_path / "dataset",
        all_of,
    )
    assert done.counts["episodes"] == 2
    assert {(one.path.name, one.is_damaged) for one in done.left_out} == {
        (f"0-{PICKED}.mcap", True), ("3-open.mcap.part", False)
    }  # fmt: skip
    for name in (f"1-{BLOCKED}.mcap", f"2-{PICKED_TOO}.mcap"):
        (folder / name).unlink()
    with pytest.raises(RecordingError, match=f"None of 1 recordings can be exported; .*0-{PICKED}"):
        export_lerobot(chosen(folder), tmp_path / "none", all_of)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("none")]


def test_an_existing_folder_is_refused_and_unchanged(recordings: Path, tmp_path: Path) -> None:
    (tmp_path / "dataset").mkdir()
    with pytest.raises(ConfigError, match="exists already"):
        export_lerobot(chosen(recordings), tmp_path / "dataset", all_of)
    (tmp_path / "mine.part").mkdir()
    (tmp_path / "mine.part" / "note").touch()
    with pytest.raises(ConfigError, match="no export made it"):
        export_lerobot(chosen(recordings), tmp_path / "mine", all_of)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["dataset", "mine.part", "note"]


def test_an_export_that_is_broken_off_leaves_nothing(recordings: Path, tmp_path: Path) -> None:
    def one_then_interrupted(paths: Iterable[Path], _total: int) -> Iterator[Path]:
        yield next(iter(paths))
        assert (tmp_path / "dataset.part" / "data").is_dir() and not (tmp_path / "dataset").exists()
        with pytest.raises(ConfigError, match="Another export writes"):
            export_lerobot(chosen(recordings), tmp_path / "dataset", all_of)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_lerobot(chosen(recordings), tmp_path / "dataset", one_then_interrupted)
    assert not list(tmp_path.iterdir())


def test_what_a_killed_export_left_is_replaced(recordings: Path, tmp_path: Path) -> None:
    part = tmp_path / "dataset.part"
    (part / "data").mkdir(parents=True)
    (part / ".vlad-cell-export").touch()
    (part / "data" / "half.parquet").touch()
    export_lerobot(chosen(recordings, "code = 'COLLISION'"), tmp_path / "dataset", all_of)
    assert not part.exists() and not list((tmp_path / "dataset").rglob("half.parquet"))
    assert not (tmp_path / "dataset" / ".vlad-cell-export").exists()


def test_a_missing_package_is_named_with_its_extra(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ConfigError, match=r"package av.*vlad-cell\[export\]"):
        export_lerobot(chosen(recordings), tmp_path / "dataset", all_of)
    with pytest.raises(ConfigError, match="0 frames a second"):
        monkeypatch.undo()
        export_lerobot(chosen(recordings), tmp_path / "dataset", all_of, fps=0)
