"""Opens a data set with the real ``lerobot`` package, in the environment of its own that it needs (`just lerobot`)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

PYTHON = Path(os.environ.get("VLAD_CELL_LEROBOT", ".venv-lerobot/bin/python"))
"""Python of that environment."""
ABSENT = f"no {PYTHON}: `just lerobot` installs it (8 GB), if it can be had; VLAD_CELL_LEROBOT names another"
_PATIENCE_S = 300.0


def is_there() -> bool:
    """Whether the environment is installed."""
    return PYTHON.is_file()


def opened(root: Path, frames: list[int]) -> dict[str, Any]:
    """Return what LeRobot says of a data set and of some of its frames. Raises: RuntimeError when it refuses.

    Returns:
        ``frames``, ``episodes``, ``tasks``; ``read``: of each frame ``state``, ``action``, ``color`` (mean of each
        channel, 0 to 1), ``depth`` (mean of the picture), ``task``, ``episode``.
    """
    command = [str(PYTHON), "-P", __file__, str(root), json.dumps(frames)]
    # -P: no module of this folder stands in for one of theirs
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": ""}
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=_PATIENCE_S, env=environment)
    if done.returncode:
        raise RuntimeError(f"LeRobot does not open {root}: {done.stderr[-2000:]}")
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


def _said(root: str, frames: list[int]) -> dict[str, Any]:
    """Runs in LeRobot's environment, which has none of ours."""
    library = import_module("lerobot.datasets.lerobot_dataset")
    dataset = library.LeRobotDataset("local/exported", root=root, video_backend="pyav")
    read = []
    for index in frames:
        frame = dataset[index]
        read.append(
            {
                "state": frame["observation.state"].tolist(),
                "action": frame["action"].tolist(),
                "color": frame["observation.images.color"].mean(dim=(1, 2)).tolist(),
                "depth": float(frame["observation.images.depth"].mean()),
                "task": frame["task"],
                "episode": int(frame["episode_index"]),
            }
        )
    tasks = list(dataset.meta.tasks.index)
    return {"frames": len(dataset), "episodes": dataset.num_episodes, "tasks": tasks, "read": read}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_said(sys.argv[1], json.loads(sys.argv[2]))) + "\n")
