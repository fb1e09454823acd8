"""Hosted models against the loopback server: does the recovered rectangle survive the model's drift?

Each scene is imagined by a real provider's client through the server, once without drift and then with it. A drifted
answer is right when the best grasp's rectangle matches the undrifted one's (Jiang et al. 2011), whose axis may be any
equivalent one of the object's outline: all axes of a round object, the two of a cube.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.detection import SETTINGS, observations
from bus.errors import CycleFailure
from bus.messages import ModelReply, Observation, Rectangle
from config.load import load_station
from config.schema import Station
from perception.detector import detect
from perception.models import Models, open_models
from perception.rectangles.metric import matches
from stand_ins import drift
from stand_ins.drift import Drift
from stand_ins.model_server import ModelServer
from stand_ins.painter import paint, say

Drifts = Drift | Callable[[int], Drift]
_ROUND, _SQUARE = {"ball", "can", "bowl", "tape"}, {"cube"}


def run(scenes: int, seed: int, provider: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """Success at every drift, of the scenes that the undrifted model solves, with three steps and with one."""
    seen = list(observations(scenes, seed))
    figures: dict[str, Any] = {"provider": provider, "scenes": scenes, "seed": seed}
    for steps in (3, 1):
        told = _steps(seen, seed, provider, steps, tell)
        figures[f"steps_{steps}"] = told
    return figures


def _steps(
    seen: list[tuple[str, Observation]], seed: int, provider: str, steps: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    presets: dict[str, Drifts] = {
        "none": drift.NONE,
        "mild": lambda number: drift.mild(seed + number),
        "hard": lambda number: drift.hard(seed + number),
    }
    undrifted = _answers(seen, presets["none"], provider, steps)
    solved = [index for index, (found, _, _) in enumerate(undrifted) if found is not None]
    figures: dict[str, Any] = {"undrifted_solved": len(solved) / len(seen), **_cost(undrifted)}
    for name, preset in presets.items():
        answers = _answers(seen, preset, provider, steps)
        right = [_same(undrifted[index][0], answers[index][0], seen[index][0]) for index in solved]
        reasons = Counter(answers[index][2] for index in solved if answers[index][2])
        figures[name] = {"success": float(np.mean(right)), "refused": dict(reasons)}
        tell(f"{provider} steps={steps} {name}: {np.mean(right):.3f} {dict(reasons)}")
    return figures


Answer = tuple[Rectangle | None, list[ModelReply], str]
"""The best grasp's rectangle, what was said (without the pictures), and the code of a failure."""


def _answers(seen: list[tuple[str, Observation]], preset: Drifts, provider: str, steps: int) -> list[Answer]:
    """Return what detection gives for every scene; the same model, one server."""
    with ModelServer(paint, say=say, drift=preset) as server, tempfile.TemporaryDirectory() as folder:
        station = load_station(
            None,
            [
                *SETTINGS,
                f"perception.model={provider}",
                f"perception.imagine.steps={steps}",
                f"perception.hosted.base_url={server.url}{'/v1' if provider == 'openai' else ''}",
                "perception.hosted.text_model=words",
                "perception.hosted.image_model=pictures",
                f"recording.folder={Path(folder)}",
            ],
        )
        with closing(open_models(station, {"OPENAI_API_KEY": "none", "GEMINI_API_KEY": "none"})) as models:
            return [_answer(observation, station, models) for _, observation in seen]


def _answer(observation: Observation, station: Station, models: Models) -> Answer:
    replies: list[ModelReply] = []

    def keep(reply: ModelReply) -> None:
        replies.append(reply.model_copy(update={"image_png": None}))

    try:
        found = detect(observation, station, models, keep)
    except CycleFailure as failure:
        return None, replies, str(failure.failure)
    return found.rectangles[found.grasps[0].rectangle], replies, ""


def _same(one: Rectangle | None, other: Rectangle | None, name: str) -> bool:
    if one is None or other is None:
        return False
    turns = [0.0, np.pi / 2] if name in _SQUARE else [one.angle_rad - other.angle_rad if name in _ROUND else 0.0]
    alike = [other.model_copy(update={"angle_rad": (other.angle_rad + turn) % np.pi}) for turn in turns]
    return any(matches(like, one) for like in alike)


def _cost(answers: list[Answer]) -> dict[str, Any]:
    """Tokens and latency a scene takes."""
    return {
        "input_tokens": median(sum(reply.usage.input_tokens for reply in replies) for _, replies, _ in answers),
        "output_tokens": median(sum(reply.usage.output_tokens for reply in replies) for _, replies, _ in answers),
        "calls": median(len(replies) for _, replies, _ in answers),
    }
