"""The scene of a recording from before detect said what it saw: one thing, on a table where the station says."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bus.messages import ObservedScene
from bus.packing import pack_image, unpack_image

Json = dict[str, Any]


def with_scene(payload: bytes) -> bytes:
    """Return the record of detect (JSON) with a scene that holds its evidence's object; unchanged without a result."""
    record: Json = json.loads(payload)
    found = record.get("result")
    if not isinstance(found, dict) or "scene" in found:
        return payload
    mask = unpack_image(found["evidence"]["object_mask"], 1, "bool")
    found["scene"] = _scene(mask)
    found["tried"] = []
    for grasp in found["grasps"]:
        grasp["instance"] = 1
    return json.dumps(record).encode()


def is_made_up(scene: ObservedScene) -> bool:
    """Whether a scene is of `with_scene`: its thing has no size, as nothing that was seen can be."""
    return any(not one.size_m.any() for one in scene.instances)


def _scene(mask: Any) -> Json:
    table = {"base_from_table": np.eye(4).tolist(), "offset_m": 0.0, "tilt_rad": 0.0}
    thing = {"number": 1, "top_m": [0.0, 0.0, 0.0], "size_m": [0.0, 0.0, 0.0], "in_view": True, "depth_share": 1.0}
    return {
        "table": table,
        "region_seen": 1.0,
        "instances": [thing],
        "labels": pack_image(mask.astype(np.uint8)),
        "unseen": pack_image(np.zeros(mask.shape, dtype=bool)),
    }
