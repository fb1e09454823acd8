"""Whole simulated picks with a hosted model's real client: recorded, replayed offline, and on after a fault."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from bus.codes import Code
from cell.replay.replay import Request, replay
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report
from stand_ins.drift import Drift
from stand_ins.model_server import Fault, ModelServer
from stand_ins.painter import paint, say

SECRET = "sk-secret-0123456789"
CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize(
    ("provider", "fault"),
    [
        ("openai", Fault.REFUSAL),
        pytest.param("gemini", Fault.TRUNCATED_PNG, marks=pytest.mark.thorough),
    ],
)
def test_a_fault_ends_its_cycle_with_its_code_and_the_next_one_picks(
    provider: str, fault: Fault, tmp_path: Path, endpoint: str
) -> None:
    with ModelServer(paint, say=say, drift=Drift(rotation_deg=25), faults=[fault], faults_for="image") as server:
        base = server.url + ("/v1" if provider == "openai" else "")
        overrides = [
            f"perception.hosted.base_url={base}",
            f"bus.endpoint={endpoint}",
            "verify.hold_s=0.5",
            "bus.stale_s=10",
            "retry.looks=0",
        ]
        command = [sys.executable, "-m", "cell", "start", "--config", str(CONFIG / f"{provider}.toml")]
        command += ["--cycles", "2", "--seed", "3", "--json", *(word for o in overrides for word in ("--set", o))]
        keys = {"OPENAI_API_KEY": SECRET + "\n", "GEMINI_API_KEY": SECRET + "\n"}  # as from $(cat FILE; echo)
        run = subprocess.run(
            command, cwd=tmp_path, env={**os.environ, **keys}, capture_output=True, text=True, timeout=180, check=False
        )
    first, second = (json.loads(line) for line in run.stdout.splitlines())
    code = {Fault.REFUSAL: Code.MODEL_REFUSED, Fault.TRUNCATED_PNG: Code.MODEL_BAD_IMAGE}[fault]
    assert (first["result"], first["code"]) == ("FAILED", code), run.stderr
    assert second["result"] == "SUCCESS", second
    for result in (first, second):
        assert replay(read_cycle(tmp_path / result["recording"]), Request()).equal, "offline: the server is closed"
    assert SECRET not in run.stdout + run.stderr
    assert all(SECRET not in _all_of(tmp_path / result["recording"]) for result in (first, second))
    record = read_cycle(tmp_path / second["recording"])
    assert [reply.step for reply in record.replies] == ["reason", "direct", "render"]
    assert record.replies[-1].image_png is not None and record.replies[-1].usage.cost_usd > 0
    page = write_report(record, tmp_path / "report.html").read_text()
    assert "USD" in page and "the picture as it came" in page
    assert sum(line.count("usd") for line in (tmp_path / "recordings/spend.jsonl").read_text().splitlines()) >= 5


def _all_of(recording: Path) -> str:
    """Every message, attachment and metadata of a recording, as text."""
    with recording.open("rb") as file:
        reader = make_reader(file)
        parts = [message.data for _, _, message in reader.iter_messages()]
        parts += [attachment.data for attachment in reader.iter_attachments()]
        parts += [str(metadata.metadata).encode() for metadata in reader.iter_metadata()]
    assert any(b"perception" in part for part in parts), "the station is among them"
    return b"".join(parts).decode("latin-1")
