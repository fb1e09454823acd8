"""Finds grasps in a saved RGB-D image. Usage: python detect_image.py [IMAGE.npz]

The file holds color (H, W, 3), depth_m (H, W), K (3, 3) and base_from_camera (4, 4); without one, an image is made up.
"""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from vlad_cell import CycleFailure, detect


def made_up() -> Mapping[str, Any]:
    """A blue box on a grey table, 38 x 104 mm and 40 mm high, from 0.6 m above it; ``base`` is 0.45 m beside it."""
    color, depth_m = np.full((360, 480, 3), 165, np.uint8), np.full((360, 480), 0.6, np.float32)
    box = np.s_[160:191, 200:284]
    color[box], depth_m[box] = (40, 90, 200), 0.56
    K = np.array([[450, 0, 240], [0, 450, 180], [0, 0, 1]])
    base_from_camera = np.array([[1, 0, 0, 0.45], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]])
    return {"color": color, "depth_m": depth_m, "K": K, "base_from_camera": base_from_camera}


image = np.load(sys.argv[1]) if len(sys.argv) > 1 else made_up()
try:
    found = detect(image["color"], image["depth_m"], image["K"], image["base_from_camera"])
except CycleFailure as failure:
    sys.exit(f"{failure.code}: {failure}")
best = found.grasps[0]
x_m, y_m, z_m = best.base_from_grasp[:3, 3]
print(f"{len(found.things)} things, {len(found.grasps)} grasps")
print(f"the best: at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m, {best.width_m * 1e3:.0f} mm wide, score {best.score:.2f}")
print("in the image:", best.rectangle.corners_px().round().tolist())
print("picture:", found.picture().save("detected.png"))
