"""The files that an installer writes of a package, so that a test has one installed that nobody has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path


def write_dist_info(folder: Path, name: str, version: str, points: Mapping[str, Iterable[str]]) -> None:
    """Write name, version and entry points of a package into ``folder``, which is to be on ``sys.path``.

    Args:
        points: by group, the lines ``name = module:attribute``.
    """
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [line for group, named in points.items() for line in (f"[{group}]", *named)]
    (info / "entry_points.txt").write_text("\n".join(lines))
