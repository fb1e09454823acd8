"""The clients of docs/examples end with one clear line, and no traceback, where they cannot go on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "examples"
NOBODY = "127.0.0.1:1"
# An eclipse-zenoh whose session takes its time to close, and takes nothing any more meanwhile; its cell refuses a pick.
BUSY_ZENOH = """
import json, threading
from contextlib import nullcontext
from types import SimpleNamespace

class ZError(Exception): ...
class Config:
    from_json5 = staticmethod(str)

class Session:
    closed = False
    late = threading.Event()
    def __enter__(self): return self
    def __exit__(self, *_):
        self.closed = True
        self.late.wait(1)
    def put(self, key, payload):
        if self.closed:
            self.late.set()
            raise ZError("session closed")
    def liveliness(self): return SimpleNamespace(declare_token=nullcontext)
    def declare_subscriber(self, key): return None
    def get(self, key, payload, timeout):
        refusal = {"ok": False, "code": "BAD_JOB", "reason": "No.", "advice": ""}
        said = {"state": "Idle"} if key.endswith("state") else refusal
        payload = SimpleNamespace(to_string=lambda: json.dumps(said))
        return SimpleNamespace(recv=lambda: SimpleNamespace(ok=SimpleNamespace(payload=payload), err=None))

def open(config): return Session()
"""


@pytest.mark.parametrize(
    "arguments",
    [("trigger.py", "sim", "{}", f"tcp/{NOBODY}"), ("http_client.py", f"http://{NOBODY}")],
    ids=lambda a: a[0],
)
def test_where_nobody_listens_it_says_so(arguments: tuple[str, ...]) -> None:
    ended = subprocess.run([sys.executable, *arguments], cwd=FOLDER, capture_output=True, text=True, timeout=60)
    (line,) = ended.stderr.splitlines()
    assert ended.returncode == 1 and line.startswith("Nobody") and NOBODY in line


def test_a_refusal_is_all_that_is_said_though_the_heartbeat_still_runs(tmp_path: Path) -> None:
    (tmp_path / "zenoh.py").write_text(BUSY_ZENOH)
    code = f"import runpy, sys; sys.path.insert(0, {str(tmp_path)!r}); runpy.run_path('trigger.py')"
    ended = subprocess.run([sys.executable, "-c", code], cwd=FOLDER, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr.split()) == (1, ["pick:", "BAD_JOB:", "No."])
