"""Objects of which there is only a mesh: read in metres, as they stand, of a plausible size and weight, or refused."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from bus.errors import ConfigError
from config.load import load_station
from drivers.sim.meshes import Faces, read_mesh
from drivers.sim.mjcf import attach, require_plausible
from drivers.sim.objects import object_file, object_names
from drivers.sim.placing import OBJECT, Placing
from drivers.sim.world import World

REGION_M = (0.32, 0.60, -0.20, 0.20)
SIZE_M = (0.04, 0.06, 0.02)
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(size: tuple[float, float, float] = SIZE_M, scale: float = 1.0) -> Faces:
    """A box that stands on z = 0."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    triangles = [one for a, b, c, d in QUADS for one in ((a, b, c), (a, c, d))]
    return corners * np.array(size) * scale, np.array(triangles, np.int32)


def obj(faces: Faces) -> bytes:
    lines = ["v {} {} {}".format(*corner) for corner in faces[0]]
    return "\n".join([*lines, *("f {} {} {}".format(*(one + 1)) for one in faces[1])]).encode()


def stl(faces: Faces) -> bytes:
    corners = faces[0].astype("<f4")
    triangles = [struct.pack("<3f", 0, 0, 1) + corners[one].tobytes() + b"\0\0" for one in faces[1]]
    return bytes(80) + struct.pack("<I", len(triangles)) + b"".join(triangles)


def ply(faces: Faces) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(faces[0])}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces[1])}\nproperty list uchar int vertex_indices\nend_header\n"
    lines = [*(" ".join(map(str, corner)) for corner in faces[0]), *("3 {} {} {}".format(*one) for one in faces[1])]
    return (head + "\n".join(lines) + "\n").encode()


def write(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize(("suffix", "written"), [(".obj", obj), (".stl", stl), (".ply", ply)])
def test_a_mesh_comes_out_as_it_was_written(tmp_path: Path, suffix: str, written: object) -> None:
    if suffix == ".ply":
        pytest.importorskip("trimesh")
    assert callable(written)
    corners, triangles = read_mesh(write(tmp_path, f"brick{suffix}", written(box())))
    np.testing.assert_allclose(corners.min(axis=0), [-0.02, -0.03, 0.0], atol=1e-7)
    np.testing.assert_allclose(corners.max(axis=0), [0.02, 0.03, 0.02], atol=1e-7)
    assert len(triangles) == 12


def test_meshes_lie_beside_mjcf_and_are_presented_as_they_stand(tmp_path: Path) -> None:
    write(tmp_path, "brick.OBJ", obj(box()))  # as some CAD programs write it
    (tmp_path / "ball").mkdir()
    write(tmp_path / "ball", "object.xml", b"<mujoco><worldbody><body><geom size='.03'/></body></worldbody></mujoco>")
    world = World(load_station(None, [f"sim.objects={tmp_path}"]))
    assert world.names == ("ball", "brick")
    world.present("brick", 1)
    low, high = Placing(world.model, world.data, REGION_M).extent()
    assert low[2] == pytest.approx(0.0, abs=1e-3) and high[2] == pytest.approx(0.02, abs=1e-3)
    assert world.model.body(OBJECT).subtreemass[0] == pytest.approx(500 * np.prod(SIZE_M), rel=1e-3)


def test_without_coacd_a_mesh_collides_as_its_hull(tmp_path: Path) -> None:
    spec = mujoco.MjSpec()
    attach(spec, write(tmp_path, "brick.stl", stl(box())), "object", in_parts=False)
    model = spec.compile()
    assert model.ngeom == 1 and model.geom_contype[0] == 1


def test_with_coacd_a_hollow_stays_hollow(tmp_path: Path) -> None:
    """Three walls: nothing collides between them."""
    pytest.importorskip("coacd")
    walls = [box((0.06, 0.06, 0.01)), box((0.01, 0.06, 0.05)), box((0.01, 0.06, 0.05))]
    corners = [walls[0][0], walls[1][0] + (-0.025, 0, 0.0), walls[2][0] + (0.025, 0, 0.0)]
    triangles = [faces[1] + 8 * index for index, faces in enumerate(walls)]
    spec = mujoco.MjSpec()
    file = write(tmp_path, "trough.obj", obj((np.concatenate(corners), np.concatenate(triangles))))
    attach(spec, file, "object")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    solid = np.flatnonzero(model.geom_contype)
    assert len(solid) >= 3
    over = data.geom_xpos[solid][np.abs(data.geom_xpos[solid][:, 0]) < 0.01]
    assert (over[:, 2] < 0.02).all()


REFUSED = {
    "in mm": (obj(box(scale=1000)), r"in mm\?.*save it in metres"),
    "in km": (obj(box(scale=1e-3)), "6e-05 m large.*in metres"),
    "tiny": (obj(box(scale=0.05)), "scale"),
    "too large": (obj(box((0.6, 0.6, 0.1))), "does not fit into the pick region"),
    "empty": (b"", "Save its triangles anew"),
    "noise": (bytes(range(256)), "Save its triangles anew"),
    "not finite": (obj(box()).replace(b"v 0.02", b"v nan", 1), "finite"),
    "flat": (obj(box((0.04, 0.06, 0.0))), "."),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_mesh_that_cannot_be_picked_is_refused_with_what_to_do(tmp_path: Path, what: str) -> None:
    content, says = REFUSED[what]
    file = write(tmp_path, "thing.obj", content)
    with pytest.raises(ConfigError, match=says) as error:
        require_plausible(file, REGION_M)
    assert str(file) in error.value.text and error.value.advice and "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"ply\n", ply(box()).replace(b"3 0 1 3", b"3 0 1 99"), bytes(range(256))])
def test_a_broken_ply_is_refused(tmp_path: Path, content: bytes) -> None:
    pytest.importorskip("trimesh")
    with pytest.raises(ConfigError, match="Save its triangles anew"):
        read_mesh(write(tmp_path, "thing.ply", content))


def test_a_ply_without_its_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[meshes\]"):
        read_mesh(write(tmp_path, "brick.ply", ply(box())))


def test_two_objects_of_one_name_are_refused(tmp_path: Path) -> None:
    write(tmp_path, "brick.obj", obj(box()))
    assert object_names(tmp_path) == ("brick",) and object_file(tmp_path, "brick") == tmp_path / "brick.obj"
    write(tmp_path, "brick.stl", stl(box()))
    with pytest.raises(ConfigError, match="two objects 'brick'"):
        object_names(tmp_path)
