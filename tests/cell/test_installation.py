"""What a person reads when this Python cannot import the program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cell import __main__, installation

ROOT = Path(installation.__file__).parents[1]


def _cell(*path: Path, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
    command = [sys.executable, "-m", "cell", "status"]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", ["bus", "config"])
def test_a_module_in_pythonpath_that_hides_one_of_ours_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / f"{name}.py").touch()
    done = _cell(tmp_path, ROOT, cwd=tmp_path.parent)
    assert done.returncode == 2
    assert done.stderr.startswith(f"INSTALLATION: {tmp_path / name}.py is imported instead of")
    assert "unset PYTHONPATH" in done.stderr and "Traceback" not in done.stderr


def test_one_beside_the_caller_is_named_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "logs.py").touch()
    done = _cell(ROOT, cwd=tmp_path)
    assert done.returncode == 2
    assert "Start the command in another folder." in done.stderr
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.chdir(tmp_path)
    assert installation._way_out(str(tmp_path / "logs.py")) == "Start the command in another folder."


def test_an_old_package_in_pythonpath_is_named(tmp_path: Path) -> None:
    (tmp_path / "pydantic.py").touch()
    done = _cell(ROOT, tmp_path, cwd=tmp_path.parent)
    assert done.returncode == 2
    assert "INSTALLATION: The package 'pydantic' cannot be imported" in done.stderr
    assert "PYTHONPATH is set" in done.stderr and "Traceback" not in done.stderr


def test_a_missing_package_is_named_with_the_environment_that_lacks_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(ROOT / ".venv"))
    said = installation.not_installed(ModuleNotFoundError("No module named 'typer'", name="typer"))
    assert f"'typer' is not installed in {sys.prefix}. Run " in said and said.endswith("setup.sh.")
    monkeypatch.setattr(sys, "prefix", "/home/somebody/env")
    said = installation.not_installed(ModuleNotFoundError("No module named 'typer'", name="typer.main"))
    assert "`deactivate` that environment first" in said


def test_another_python_of_the_environment_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHOME", "/usr")
    said = installation.not_installed(ModuleNotFoundError("No module named '_ctypes'", name="_ctypes"))
    assert said.endswith("PYTHONHOME leads to another Python. Unset it.")


def test_a_missing_module_of_ours_stays_a_defect() -> None:
    assert installation.not_installed(ModuleNotFoundError("No module named 'bus.gone'", name="bus.gone")) == ""
    assert installation.not_installed(ImportError("no name")) == ""


def test_ctrl_c_during_the_imports_ends_without_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def hidden() -> str:
        seen.append(signal.getsignal(signal.SIGINT))
        return ""

    monkeypatch.setattr(__main__, "hidden", hidden)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # who runs the tests may ignore it
    try:
        __main__._command()
        assert seen == [signal.SIG_DFL]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
