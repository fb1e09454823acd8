"""The pure stages decide on the golden recordings what behaviour.json says (`just golden-update`)."""

from __future__ import annotations

import json

from tests.golden.behaviour import BEHAVIOUR, FOLDER, behaviour


def test_the_golden_recordings_are_decided_as_written_down() -> None:
    written = json.loads(BEHAVIOUR.read_text())
    assert set(written) == {path.name for path in FOLDER.glob("*.mcap")}
    assert json.loads(json.dumps(behaviour())) == written


def test_the_golden_recordings_stay_small() -> None:
    assert sum(path.stat().st_size for path in FOLDER.glob("*.mcap")) < 6_000_000
