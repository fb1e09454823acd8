"""The time of simulated cycles, part by part, by the robot's clock and by the wall's, and the least there could be.

The robot's clock is the simulation's (`HandState.clock_s`): motion, hold, and the hand, which is what is left of the
time from the first motion to the last: the fingers when the arm waits for them, and the arm coming to rest. The bound
is the time-optimal motions of the same paths (jerk unlimited), the fingers at their speeds, and the hold.

The wall's: what each request of a device took (motion, hold, hand, capture), the stages that only compute, the bus, the
log (opening the recording), and the rest. The bus is the time of one question, measured between two pieces of the hold,
times the questions; it is counted there and not in what was asked for.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any

from mcap.reader import make_reader

from benchmarks.judge import optimal_s
from bus import topics
from bus.messages import CycleResult, Delivery, Detections, Execution, Grasp, PickPlan, SegmentRun
from config.devices import HandSettings
from logs.mcap.reader import CycleRecord, read_cycle
from logs.recorded_station import recorded_station

_COMPUTING = ("detect", "plan", "verify")
_ASKED = {
    topics.ARM_EXECUTE.key: "motion",
    topics.HAND_MOVE.key: "hand",
    topics.HAND_GRASP.key: "hand",
    topics.CAMERA_CAPTURE.key: "capture",
    topics.SIM_PRESENT.key: "laying",
}


def figures(results: Iterable[CycleResult]) -> dict[str, Any]:
    """Medians over the successful cycles, of each part [s], and of the ratio to the bound."""
    robot: dict[str, list[float]] = defaultdict(list)
    wall: dict[str, list[float]] = defaultdict(list)
    for result in results:
        if result.result != "SUCCESS":
            continue
        record = read_cycle(Path(result.recording))
        for name, seconds in _by_robot(record).items():
            robot[name].append(seconds)
        for name, seconds in _by_wall(record, result).items():
            wall[name].append(seconds)
    return {"robot_s": _medians(robot), "wall_s": _medians(wall)}


def _medians(parts: dict[str, list[float]]) -> dict[str, float]:
    return {name: round(median(values), 3) for name, values in parts.items()}


# --- the robot's clock ------------------------------------------------------------------------------------------------


def _by_robot(record: CycleRecord) -> dict[str, float]:
    found, plan, execution, delivery = (record.stages[name].result for name in ("detect", "plan", "execute", "deliver"))
    assert isinstance(found, Detections) and isinstance(plan, PickPlan)
    assert isinstance(execution, Execution) and isinstance(delivery, Delivery)
    runs = (*execution.runs, *delivery.runs)
    began, ended = execution.began, runs[-1].hand.clock_s
    assert began is not None and began.clock_s is not None and ended is not None, "only a simulation has a clock"
    parts: dict[str, float] = {run.name: 0.0 for run in runs}
    for run in runs:
        parts[run.name] += _lasted_s(run)
    total_s = ended - began.clock_s
    hand = recorded_station(record).hand
    bound_s = (
        sum(optimal_s(part.trajectory) for part in plan.segments if part.name in parts)
        + _fingers_s(found.grasps[plan.grasp], execution, delivery, hand)
        + parts["hold"]
    )
    return {
        **parts,
        "hand": total_s - sum(parts.values()),
        "total": total_s,
        "bound": bound_s,
        "over_bound": total_s / bound_s,
    }


def _lasted_s(run: SegmentRun) -> float:
    return float(run.motion.t_s[-1])


def _fingers_s(grasp: Grasp, execution: Execution, delivery: Delivery, hand: HandSettings) -> float:
    """The way of the fingers onto the object and off it, at their speeds; the opening hides behind the reach."""
    assert execution.grasped is not None and delivery.released is not None
    onto_m = grasp.opening_m - execution.grasped.width_m
    off_m = delivery.released.width_m - execution.grasped.width_m
    return max(0.0, onto_m) / hand.speed_m_s + max(0.0, off_m) / hand.max_speed_m_s


# --- the wall's clock -------------------------------------------------------------------------------------------------


def _by_wall(record: CycleRecord, result: CycleResult) -> dict[str, float]:
    asked = _asked(Path(result.recording))
    names: list[str] = [run.name for stage in ("execute", "deliver") for run in _runs(record, stage)]
    looks = len(asked[topics.ARM_EXECUTE.key]) - len(names)
    question_s = _question_s(asked[topics.ARM_EXECUTE.key][looks:], names)
    parts = dict.fromkeys(("capture", "motion", "hold", "hand", "laying"), 0.0)
    for key, times in asked.items():
        for number, (begin_s, end_s) in enumerate(times):
            is_hold = key == topics.ARM_EXECUTE.key and number >= looks and names[number - looks] == "hold"
            parts["hold" if is_hold else _ASKED[key]] += max(0.0, end_s - begin_s - question_s)
    parts["compute"] = sum(result.stages[name] for name in _COMPUTING)
    parts["bus"] = question_s * sum(2 * len(times) for times in asked.values())  # each, and the state after it
    parts["log"] = max(0.0, result.wall_s - sum(result.stages.values()) - parts.pop("laying"))
    parts["rest"] = max(0.0, sum(result.stages.values()) + parts["log"] - sum(parts.values()))
    return {**parts, "total": sum(parts.values())}


def _runs(record: CycleRecord, stage: str) -> tuple[SegmentRun, ...]:
    message = record.stages[stage].result
    assert isinstance(message, Execution | Delivery)
    return message.runs


def _question_s(executed: list[tuple[float, float]], names: list[str]) -> float:
    """Between two pieces of a hold the hand is asked for its state, and nothing else happens."""
    gaps = [
        executed[i + 1][0] - executed[i][1]
        for i in range(len(executed) - 1)
        if names[i] == names[i + 1] == "hold"
    ]  # fmt: skip
    return median(gaps) if gaps else 0.0


def _asked(path: Path) -> dict[str, list[tuple[float, float]]]:
    """Of every kind of question that takes time: when each was asked and answered [s]."""
    begun: dict[str, list[float]] = defaultdict(list)
    times: dict[str, list[tuple[float, float]]] = {key: [] for key in _ASKED}
    answered = {_answer_of(key): key for key in _ASKED}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            topic = channel.topic.lstrip("/")
            asked_for = topic.removesuffix("/query")
            if topic.endswith("/query") and asked_for in _ASKED:
                begun[asked_for].append(message.log_time / 1e9)
            elif topic in answered and begun[answered[topic]]:
                key = answered[topic]
                times[key].append((begun[key].pop(0), message.log_time / 1e9))
    return times


def _answer_of(key: str) -> str:
    """The topic of its answer; a capture's are the frame's parts, of which depth is a late one."""
    return topics.CAMERA_DEPTH.key if key == topics.CAMERA_CAPTURE.key else f"{key}/reply"
