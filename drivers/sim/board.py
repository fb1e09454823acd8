"""The ChArUco board on the simulated table."""

from __future__ import annotations

import mujoco
import numpy as np

from config.calibration import CalibrationSettings
from config.charuco import board_image

_PIXELS_PER_M = 4000.0
_THICK_M = 0.002


def lay_board(spec: mujoco.MjSpec, settings: CalibrationSettings) -> None:
    """Add the board to the world, face up, its middle at ``board_center_m``."""
    grey = board_image(settings, _PIXELS_PER_M)
    height, width = grey.shape
    texture = spec.add_texture(name="board", type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height)
    texture.nchannel = 3
    texture.data = np.repeat(grey[..., None], 3, axis=-1).tobytes()
    material = spec.add_material(name="board", specular=0.0, shininess=0.0, reflectance=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "board"
    half_x, half_y = (side / 2 for side in settings.size_m)
    x, y, z = settings.board_center_m
    yaw = settings.board_yaw_rad / 2
    spec.worldbody.add_geom(
        name="board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half_x, half_y, _THICK_M / 2],
        pos=[x, y, z + _THICK_M / 2],
        quat=[np.cos(yaw), 0.0, 0.0, np.sin(yaw)],
        material="board",
        contype=0,
        conaffinity=0,
    )
