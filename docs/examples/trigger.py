"""Triggers one pick from any program, with plain eclipse-zenoh only.

Usage: python trigger.py [cell_id [JOB [ENDPOINT]]]

JOB: a job as JSON, {"target": {"text": "the largest"}}; or a colour: what shows it most is picked by its pixel.
ENDPOINT: tcp/127.0.0.1:7447, if left out.
"""

import base64
import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

client_id = "trigger"
cell = f"cell/{sys.argv[1] if len(sys.argv) > 1 else 'sim'}"
endpoint = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7447"
config = f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'


def opened() -> zenoh.Session:
    try:
        return zenoh.open(zenoh.Config.from_json5(config))
    except zenoh.ZError:
        sys.exit(f"Nobody listens at {endpoint}: does the cell run, with that bus.endpoint?")


def ask(key: str, **fields: Any) -> dict[str, Any]:
    try:
        reply = session.get(f"{cell}/{key}", payload=json.dumps(fields), timeout=5).recv()
    except zenoh.ZError:  # no answer at all
        sys.exit(f"Nobody serves {cell}/{key} at {endpoint}: is the cell's id right, and does it run?")
    said = reply.ok or reply.err
    assert said is not None  # a reply is one of the two
    answer: dict[str, Any] = json.loads(said.payload.to_string())
    return answer


def command(verb: str, **fields: Any) -> dict[str, Any]:
    answer = ask(f"command/{verb}", client_id=client_id, **fields)
    if not answer["ok"]:
        sys.exit(f"{verb}: {answer['code']}: {answer['reason']} {answer['advice']}")
    return answer


def job(wanted: str) -> Any:
    if wanted.startswith("{"):
        try:
            return json.loads(wanted)
        except ValueError as error:
            sys.exit(f"The job is no JSON: {error}")
    from pixel import pixel_of  # type: ignore[import-not-found] # noqa: PLC0415 - the file beside this one, where it is asked for

    picture = ask("view/picture")
    if "data" not in picture:
        sys.exit(f"view/picture: {picture['code']}: {picture['reason']} {picture['advice']}")
    try:
        pixel = pixel_of(base64.b64decode(picture["data"]), wanted)
    except ValueError as error:
        sys.exit(f"There is no target: {error}.")
    return {"target": {"pixel": pixel, "picture_ns": picture["stamp_ns"]}}


@contextmanager
def attending() -> Iterator[None]:
    """Hold the lease: the arm moves for us while its token lives and while we say so; when this program ends or hangs,
    the cell holds within a second."""
    done = threading.Event()

    def say_that_we_run() -> None:
        while not done.wait(0.2):
            session.put(f"{cell}/lease/{client_id}", "{}")

    speaker = threading.Thread(target=say_that_we_run, daemon=True)
    with session.liveliness().declare_token(f"{cell}/lease/{client_id}"):
        speaker.start()
        try:
            yield
        finally:  # also where a refusal ends the program: nothing is said once the session is closed
            done.set()
            speaker.join()


with opened() as session, attending():
    results = session.declare_subscriber(f"{cell}/cycle/result")
    if ask("state")["state"] not in ("Idle", "Complete"):
        command("reset")
    while (state := ask("state")["state"]) == "Resetting":
        time.sleep(0.1)
    print(f"{state}; picking")
    cycle_id = command("pick", job=job(sys.argv[2] if len(sys.argv) > 2 else "{}"))["cycle_id"]
    while "result" not in (answer := ask("cycle/result", cycle_id=cycle_id)):
        results.recv()  # what is heard only wakes: the cell itself is asked
    print("result ->", answer)
