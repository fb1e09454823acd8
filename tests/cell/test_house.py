"""How `benchmarks house` reads a checkout: a small one with every fault that it counts."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from benchmarks.arrows import circles
from benchmarks.house import measure

_TREE = {
    "bus/__init__.py": '"""What is said."""',
    "bus/errors.py": """
        from typing import TYPE_CHECKING
        if TYPE_CHECKING:
            from bus.messages import Message
        """,
    "bus/messages.py": "from bus.errors import CellError",
    "config/load.py": "from planning import timing",
    "drivers/node.py": "from logs.recorder import Recorder",
    "logs/recorder.py": "",
    "perception/lift.py": "from perception.align import icp",
    "perception/align/__init__.py": "",
    "perception/align/icp.py": "from ..lift import lift",
    "planning/timing.py": "import numpy, bus.messages",
    "cell/client.py": """
        def late():
            from cell.daemon import Daemon
        """,
    "cell/daemon.py": "import cell.client",
    "cell/build.py": 'daemon = LazyModule("cell.daemon")',
    "tests/test_loops.py": """
        from benchmarks.soak import soak, trials
        def test_late(monkeypatch):
            monkeypatch.setattr("drivers.node._LATE_S", 1.0)
            monkeypatch.setattr(
                node, "_late", 1.0
            )
            monkeypatch.setattr("drivers.node.RATE_HZ", 1.0)
        """,
    "benchmarks/soak.py": "from tests.stand_ins.painter import paint",
}


def _write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(dedent(text).strip() + "\n")
    return root


@pytest.fixture
def figures(tmp_path: Path) -> dict[str, Any]:
    return measure(_write(tmp_path, _TREE), tell=lambda line: None)


def _of_module(tmp_path: Path, text: str) -> dict[str, Any]:
    """The figures of a package that is this module alone."""
    packages = measure(_write(tmp_path, {"bus/only.py": text}), tell=lambda line: None)["packages"]
    only: dict[str, Any] = packages["bus"]
    return only


def test_a_folder_is_a_room_and_the_files_beside_it_are_another(figures: dict[str, Any]) -> None:
    rooms = {"count": 2, "most_files": 2, "files": {"perception/align": 2, "perception": 1}}
    assert figures["packages"]["perception"]["rooms"] == rooms
    assert figures["total"]["files"] == 13


def test_arrows_count_once_inside_a_package_and_between_packages(figures: dict[str, Any]) -> None:
    arrows = figures["total"]["arrows"]
    assert arrows["modules"] == {"inside": 5, "between_packages": 3}
    assert arrows["rooms"] == {"inside": 2, "between_packages": 3}


def test_circles_between_modules_and_between_rooms_are_named(figures: dict[str, Any]) -> None:
    found = figures["total"]["circles"]
    assert found["modules"] == [["cell.client", "cell.daemon"], ["perception.align.icp", "perception.lift"]]
    assert found["rooms"] == [["perception/align", "perception/lift"]], "beside a folder, a file is a room of its own"


def test_an_import_for_type_checkers_closes_no_circle_but_is_counted_apart(figures: dict[str, Any]) -> None:
    bus = figures["packages"]["bus"]
    assert bus["circles"]["modules"] == []
    assert bus["arrows"]["for_types_only"] == 1
    assert bus["circles"]["modules_by_any_arrow"] == [["bus.errors", "bus.messages"]]


def test_a_module_named_in_a_string_is_counted_apart(figures: dict[str, Any]) -> None:
    assert figures["packages"]["cell"]["arrows"]["by_string_only"] == 1


def test_arrows_up_and_between_siblings_are_named(figures: dict[str, Any]) -> None:
    assert figures["total"]["up"] == ["config.load -> planning.timing"]
    assert figures["total"]["sideways"] == ["drivers.node -> logs.recorder"]


def test_private_names_patched_by_string_and_imports_between_tests_and_benchmarks(figures: dict[str, Any]) -> None:
    tests = figures["tests"]
    assert tests["private_patches"] == 2
    assert (tests["names_from_benchmarks"], tests["benchmarks_names_from_tests"]) == (2, 1)


def test_two_circles_that_touch_are_one() -> None:
    assert circles([("a", "b"), ("b", "a"), ("b", "c"), ("c", "b"), ("c", "d")]) == [["a", "b", "c"]]


def test_a_function_is_as_long_as_its_definition_without_its_docstring(tmp_path: Path) -> None:
    lines = _of_module(
        tmp_path,
        '''
        @decorated
        def four(
            a: int,
        ) -> int:
            """Two lines

            that do not count, and a blank one."""
            return a
        def one() -> None: ...
        ''',
    )["function_lines"]
    assert lines == {"count": 2, "median": 2.5, "p90": 4, "max": 4, "longest": "bus.only:2 four"}


def test_docstrings_are_asked_for_units_and_for_what_is_taken_and_raised(tmp_path: Path) -> None:
    found = _of_module(
        tmp_path,
        '''
        def pose(angle: float) -> Array:
            """The pose (4, 4). Raises: ValueError when it is not finite."""
        def speed(distance: float) -> float:
            """How fast.

            Args:
                distance: along the path.
            """
        def tries(count: int) -> None:
            """How often."""
        class Scene:
            clearance_m: float
            def close(self) -> None: ...
        def _private(angle: float) -> None: ...
        ''',
    )["docstrings"]
    assert (found["public"], found["documented"]) == (5, 0.6)
    assert (found["args"], found["raises"], found["args_or_raises"]) == (0.333, 0.333, 0.667)
    assert (found["with_numbers"], found["unit_or_shape"]) == (3, 0.333)
    assert (found["with_floats_or_arrays"], found["unit_or_shape_of_floats_or_arrays"]) == (2, 0.5)


def test_a_name_that_stands_for_an_array_type_is_one(tmp_path: Path) -> None:
    text = 'Mask = npt.NDArray[np.bool_]\ndef area(mask: Mask) -> None:\n    """Pixels of a mask (H, W)."""\n'
    assert _of_module(tmp_path, text)["docstrings"]["unit_or_shape"] == 1.0


def test_broad_excepts_any_and_vague_words(tmp_path: Path) -> None:
    found = _of_module(
        tmp_path,
        '''
        """What somebody reads."""
        limit: Any = cast(Any, 1)
        def read(*given: list[Any]) -> dict[str, typing.Any]:
            try:
                return "whoever is in a plain string"
            except (OSError, Exception):
                pass  # Whoever asks
            except OSError:
                pass
            except:
                raise
        ''',
    )
    assert (found["broad_excepts"], found["any_in_annotations"], found["whoever_or_somebody"]) == (2, 3, 2)
    assert (found["module_docstrings"], found["module_docstrings_with_what"]) == (1, 1)
    assert found["broad_excepts_per_kloc"] == round(2 / 11 * 1000, 2)


def test_a_folder_without_the_packages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="name a checkout's folder"):
        measure(tmp_path, tell=lambda line: None)
