"""The settings of a recorded station, one by one."""

from __future__ import annotations

import math
from collections.abc import Iterator


def settings_in(tree: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield each setting of a tree of tables with its full name; a list, and an empty table, is one setting."""
    if isinstance(tree, dict) and tree:
        for key, value in tree.items():
            yield from settings_in(value, f"{path}.{key}" if path else str(key))
    else:
        yield path, tree


def recorded_number(tree: object, *keys: str) -> float | None:
    """Return a numeric setting of a recorded station of any version; None without such a number."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return float(tree) if isinstance(tree, int | float) and math.isfinite(tree) else None
