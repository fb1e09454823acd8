"""The simulated camera sees what the fingers touch: contact parts that reach beyond the visual mesh are drawn."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from drivers.sim.mjcf import attach
from drivers.sim.shown import show_what_is_touched

SEEN_GROUP, CONTACT_GROUP = 2, 3
RGBA = (0.2, 0.4, 0.6)


def block(side_m: tuple[float, float, float]) -> str:
    """The corners of a block about the origin, for a mesh."""
    return " ".join(f"{x * side_m[0] / 2} {y * side_m[1] / 2} {z * side_m[2] / 2}"
                    for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))  # fmt: skip


def wall(folder: Path, touched_mm: float, alpha: float = 1.0) -> mujoco.MjModel:
    """A wall that looks 4 mm thick, and is ``touched_mm`` thick to the touch."""
    file = folder / "object.xml"
    rgba = " ".join(map(str, (*RGBA, alpha)))
    file.write_text(f"""<mujoco><asset>
        <mesh name="seen" vertex="{block((0.1, 0.004, 0.08))}"/>
        <mesh name="touched" vertex="{block((0.1, touched_mm / 1e3, 0.08))}"/>
        </asset><worldbody><body>
        <geom type="mesh" mesh="seen" rgba="{rgba}" group="2" contype="0" conaffinity="0"/>
        <geom type="mesh" mesh="touched" rgba="1 0 0 1" group="3"/>
        </body></worldbody></mujoco>""")
    spec = mujoco.MjSpec()
    attach(spec, file, "object")
    model: mujoco.MjModel = spec.compile()
    show_what_is_touched(model, "object")
    return model


def test_a_part_beyond_the_picture_is_drawn_in_its_colour(tmp_path: Path) -> None:
    model = wall(tmp_path, 10.0)
    assert model.geom_group.tolist() == [SEEN_GROUP, SEEN_GROUP]
    np.testing.assert_allclose(model.geom_rgba[1, :3], RGBA, atol=1e-6)
    assert model.geom_contype.tolist() == [0, 1]


@pytest.mark.parametrize("touched_mm", [3.0, 4.0, 7.0])
def test_a_part_that_is_about_what_is_seen_stays_hidden(tmp_path: Path, touched_mm: float) -> None:
    assert wall(tmp_path, touched_mm).geom_group.tolist() == [SEEN_GROUP, CONTACT_GROUP]


@pytest.mark.parametrize(("alpha", "drawn"), [(0.9, 1.0), (0.2, 0.2)])
def test_what_is_nearly_opaque_has_depth(tmp_path: Path, alpha: float, drawn: float) -> None:
    assert wall(tmp_path, 4.0, alpha).geom_rgba[0, 3] == pytest.approx(drawn)
