"""The camera's stand-in ends at once, and without a word, though it still draws."""

from __future__ import annotations

import subprocess
import sys

ENDLESS = """
import atexit, threading
from stand_ins.femto_mega import __main__ as stand_in

stand_in.Server = lambda *_: None
atexit.register(print, "Python shuts down")
stand_in.serve_and_end("127.0.0.1", iter(threading.Event().wait, None))
"""


def test_python_does_not_shut_down_around_a_thread_that_draws() -> None:
    done = subprocess.run([sys.executable, "-c", ENDLESS], input="", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "serving\n", "")
