"""Objects as the world has them: what is picked of them, and what is refused before anything moves, and why."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest

from bus.errors import ConfigError
from config.load import load_station
from drivers.sim.mjcf import attach, require_plausible
from drivers.sim.objects import object_names, require_presentable
from drivers.sim.placing import Placing
from drivers.sim.world import World

REGION_M = (0.32, 0.60, -0.20, 0.20)
BOX = '<geom type="box" size="0.02 0.03 0.01" mass="0.1"/>'
PART = '<geom type="box" size="0.02 0.03 0.01" mass="0.1" group="3"/>'
BITS = '<geom type="box" size="0.02 0.03 0.01" mass="0.1" contype="4" conaffinity="2"/>'
POSE = '<sensor><framepos objtype="body" objname="b"/></sensor>'
MOTOR = '<actuator><motor joint="j"/></actuator>'
TEXTURE = '<asset><texture name="t" type="2d" file="t.png"/></asset>'
MESHED = '<asset><mesh name="m" file="m.obj"/></asset>', '<body><geom type="mesh" mesh="m"/></body>'


def mjcf(bodies: str, before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{bodies}</worldbody>{after}</mujoco>"


def mesh(side: float) -> str:
    """A tetrahedron, as an OBJ."""
    return f"v 0 0 0\nv {side} 0 0\nv 0 {side} 0\nv 0 0 {side}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write(folder: Path, content: str | bytes, name: str = "object.xml", thing: str = "thing") -> Path:
    file = folder / thing / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


LOADS = {
    "a body": mjcf(f"<body>{BOX}</body>"),
    "nested": mjcf(f'<body><body name="object">{BOX}</body><site name="top" pos="0 0 0.01"/></body>'),
    "nested, with contact parts": mjcf(f'<body><body>{PART}</body><geom type="sphere" size="0.02"/></body>'),
    "in frames": mjcf(f'<frame pos="0 0 1"><body><frame pos="0 0 0.01">{BOX}</frame></body></frame>'),
    "on a floor": mjcf(f'<light pos="0 0 3"/><geom type="plane" size="1 1 1"/><body>{BOX}</body>'),
    "with a key": mjcf(f"<body><freejoint/>{BOX}</body>", after='<keyframe><key qpos="0 0 0 1 0 0 0"/></keyframe>'),
    "with a sensor": mjcf(f'<body name="b">{BOX}</body>', after=POSE),
    "on a rail": mjcf(f'<body><joint name="j" type="slide"/>{BOX}</body>', after=MOTOR),
    "of other contact bits": mjcf(f"<body>{BITS}</body>"),
    "moved by others": mjcf(f'<body mocap="true">{BOX}</body>'),
    "with a byte order mark": "\ufeff" + mjcf(f"<body>{BOX}</body>"),
    "with a memory": mjcf(f"<body>{BOX}</body>", '<size memory="1M"/><statistic extent="3"/>'),
    "named nan": mjcf(f'<body name="nan">{BOX}</body>'),
}  # fmt: skip


@pytest.mark.parametrize("layout", LOADS)
def test_it_comes_out_as_one_free_thing_that_can_be_touched_everywhere(tmp_path: Path, layout: str) -> None:
    file = write(tmp_path, LOADS[layout])
    require_plausible(file, REGION_M)
    spec = mujoco.MjSpec()
    attach(spec, file, "object-3")
    model = spec.compile()
    assert model.njnt == 1 and model.joint("object-3").type == mujoco.mjtJoint.mjJNT_FREE
    assert model.body("object-3").subtreemass == pytest.approx(0.1)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = Placing(model, data, REGION_M, "object-3").extent()
    np.testing.assert_allclose(high - low, [0.04, 0.06, 0.02])


REFUSED: dict[str, tuple[str | bytes, str]] = {
    "two bodies": (mjcf(f'<body name="a">{BOX}</body><body name="b">{BOX}</body>'), "2 bodies: 'a', 'b'"),
    "geoms beside the body": (mjcf(f"{BOX}<body>{BOX}</body>"), "1 geoms outside of a body"),
    "no body": (mjcf(""), "no body with a geom"),
    "no geom": (mjcf("<body/>"), "no body with a geom"),
    "a hinge within": (mjcf(f'<body>{BOX}<body><joint name="lid"/>{BOX}</body></body>'), "joints within it: lid"),
    "a total mass": (mjcf(f"<body>{BOX}</body>", '<compiler settotalmass="1"/>'), "settotalmass"),
    "only to look at": (mjcf('<body><geom size="0.02" contype="0" conaffinity="0"/></body>'), "can be touched"),
    "only to touch": (mjcf('<body><geom size="0.02" mass="0.1" group="3"/></body>'), "nothing that can be seen"),
    "glass": (mjcf('<body><geom size="0.02" mass="0.1" rgba="1 1 1 0"/></body>'), "nothing that can be seen"),
    "without mass": (mjcf('<body><geom size="0.02" mass="0"/></body>'), "mass"),
    "of negative mass": (mjcf('<body><geom size="0.02" mass="-1"/></body>'), "negative"),
    "of no mass": (mjcf('<body><geom size="0.02" mass="nan"/></body>'), 'mass="nan"'),
    "of endless mass": (mjcf('<body><geom size="0.02" mass="inf"/></body>'), 'mass="inf"'),
    "nowhere": (mjcf('<body><geom size="0.02" mass="0.1" pos="nan 0 0"/></body>'), 'pos="nan 0 0"'),
    "of lead": (mjcf('<body><geom size="0.02" mass="11"/></body>'), "weighs 11 kg"),
    "of air": (mjcf('<body><geom size="0.02" mass="1e-5"/></body>'), "weighs 1e-05 kg"),
    "a foil": (mjcf('<body><geom type="box" size="0.02 0.02 1e-6" mass="0.1"/></body>'), "m small"),
    "far from its origin": (mjcf('<body><geom size="0.02" mass="0.1" pos="0 2 0"/></body>'), "far from the origin"),
    "a table": (mjcf('<body><geom type="box" size="0.4 0.4 0.01" mass="1"/></body>'), "enlarge scene.pick_region_m"),
    "broken": ("<mujoco><worldbody>", "XML"),
    "empty": ("", "empty file"),
    "another kind": ("<scene/>", "Unrecognized|unrecognized|root"),
    "not UTF-8": (mjcf(f'<body name="Fl\xe4che">{BOX}</body>').encode("latin-1"), "not UTF-8"),
    "UTF-16": (mjcf(f"<body>{BOX}</body>").encode("utf-16"), "not UTF-8"),
    "a part is missing": (mjcf('<include file="none.xml"/>'), "none.xml"),
    "a mesh is missing": (mjcf(MESHED[1], MESHED[0]), "m.obj"),
    "a texture is missing": (mjcf(f"<body>{BOX}</body>", TEXTURE), "t.png"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_in_one_line_that_names_the_file(tmp_path: Path, what: str) -> None:
    content, says = REFUSED[what]
    file = write(tmp_path, content)
    with pytest.raises(ConfigError, match=says) as error:
        require_plausible(file, REGION_M)
    assert str(file) in error.value.text and "\n" not in str(error.value) and error.value.advice


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (mesh(50.0), r'in mm\? Then give its <mesh> scale="0.001'),
        (mesh(0.002), "Is the scale"),
        ("", "4 vertices"),
        (mesh(0.05).replace("0.05", "nan", 1), "not finite"),
        (mesh(0.05).replace("0 0 0.05", "0.05 0.05 0"), "coplanar"),
        (bytes(range(256)), "vertices"),
    ],
    ids=["mm", "tiny", "empty", "nan", "flat", "noise"],
)
def test_a_mesh_that_cannot_be_is_refused(tmp_path: Path, content: str | bytes, says: str) -> None:
    write(tmp_path, content, "m.obj")
    with pytest.raises(ConfigError, match=says):
        require_plausible(write(tmp_path, mjcf(MESHED[1], MESHED[0])), REGION_M)


def test_one_bad_object_of_a_folder_is_found_at_the_start(tmp_path: Path) -> None:
    for name, content in (("a", LOADS["nested"]), ("z", REFUSED["two bodies"][0])):
        write(tmp_path, content, thing=name)
    with pytest.raises(ConfigError, match=r"z/object\.xml holds 2 bodies"):
        World(load_station(None, [f"sim.objects={tmp_path}"]))


def test_a_folder_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    folder = os.path.join(os.fsencode(tmp_path), b"caf\xe9")
    os.mkdir(folder)
    Path(os.fsdecode(folder), "object.xml").write_text(LOADS["nested"])
    with pytest.raises(ConfigError, match="not UTF-8"):
        object_names(tmp_path)
    require_presentable(None, REGION_M)


def test_objects_whose_assets_have_the_same_names_keep_their_own(tmp_path: Path) -> None:
    for name, side_m in (("a", 0.03), ("b", 0.05)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "m.obj").write_text(mesh(side_m))
        asset = '<asset><material name="x"/><mesh name="m" file="m.obj"/></asset>'
        default = f'<default><default class="c"><geom mass="{side_m}"/></default></default>'
        body = (
            '<body name="object" childclass="c"><body><geom name="g" type="mesh" mesh="m" material="x"/></body></body>'
        )
        (tmp_path / name / "object.xml").write_text(mjcf(body, default + asset))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world = World(load_station(None, [f"sim.objects={tmp_path}", "sim.clutter=2"]))
    for body, name in world.objects.items():
        side_m = {"a": 0.03, "b": 0.05}[name]
        low, high = Placing(world.model, world.data, REGION_M, body).extent()
        assert (high - low)[2] == pytest.approx(side_m, abs=1e-3)
        assert world.model.body(body).subtreemass == pytest.approx(side_m)
