"""Who draws is chosen by the environment; for want of a choice, EGL does."""

from __future__ import annotations

import os

import pytest

from drivers import egl


@pytest.mark.parametrize(("was", "becomes"), [("", "egl"), ("egl", "egl"), ("osmesa", "osmesa")])
def test_egl_draws_unless_another_is_named(monkeypatch: pytest.MonkeyPatch, was: str, becomes: str) -> None:
    monkeypatch.setenv("MUJOCO_GL", was)
    egl.choose()
    assert os.environ["MUJOCO_GL"] == becomes


def test_the_advice_names_what_was_set_for_another_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    assert egl.advice().startswith("Install EGL: apt-get")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "osmesa")
    assert egl.advice().startswith("Unset PYOPENGL_PLATFORM (it says osmesa)")
