"""Picks once over HTTP, with the standard library only, and attends it: python http_client.py [URL [JOB [TOKEN]]]

JOB: a job as JSON, {"target": {"text": "the largest"}}; or a colour: what shows it most is picked by its pixel.
"""

import json
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

url = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8088"
headers = {"Content-Type": "application/json"}
wanted = sys.argv[2] if len(sys.argv) > 2 else '{"job_id": "example"}'
if len(sys.argv) > 3:
    headers["Authorization"] = f"Bearer {sys.argv[3]}"


def opened(path: str, body: bytes | None = None) -> Any:
    """The answer to a GET, or with a body to a POST; a refusal, or nobody there, ends the program with one line."""
    try:
        return urllib.request.urlopen(urllib.request.Request(f"{url}{path}", body, headers))
    except urllib.error.HTTPError as refusal:
        why = json.loads(refusal.read())
        sys.exit(f"{path}: {why['code']}: {why['reason']} {why['advice']}")
    except urllib.error.URLError as error:
        sys.exit(f"Nobody answers at {url}: {error.reason}. Does the cell run, with http.enabled?")


def post(path: str, body: dict[str, Any]) -> dict[str, Any]:
    with opened(path, json.dumps(body).encode()) as answer:
        said: dict[str, Any] = json.loads(answer.read() or "{}")
        return said


def events(path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what the cell says, as (name, content)."""
    with opened(path) as stream:
        name = ""
        for line in stream:
            field, _, value = line.decode().strip().partition(": ")
            if field == "event":
                name = value
            elif field == "data":
                yield name, json.loads(value)


def job() -> Any:
    if wanted.startswith("{"):
        try:
            return json.loads(wanted)
        except ValueError as error:
            sys.exit(f"The job is no JSON: {error}")
    from pixel import pixel_of  # type: ignore[import-not-found] # noqa: PLC0415 - the file beside this one, where it is asked for

    with opened("/api/picture/now") as picture:
        taken_ns = int(picture.headers["X-Stamp-Ns"])
        try:
            return {"target": {"pixel": pixel_of(picture.read(), wanted), "picture_ns": taken_ns}}
        except ValueError as error:
            sys.exit(f"There is no target: {error}.")


cycle_id = ""
for name, said in events("/api/events?client=example"):
    if name == "session":
        # While this stream is open and its heartbeat comes, the arm moves for us; else the cell holds.
        headers["X-Cell-Session"] = said["session"]
    elif name == "ping":
        post("/api/heartbeat", {})
    elif name == "state" and said["state"] in ("Stopped", "Complete") and not cycle_id:
        post("/api/commands/reset", {})
    elif name == "state" and said["state"] == "Idle" and not cycle_id:
        print("Idle; picking")
        cycle_id = post("/api/commands/pick", {"job": job()})["cycle_id"]
    elif name == "result" and said["cycle_id"] == cycle_id:
        print("result ->", said)
        if not said["retried_as"]:
            break
        cycle_id = said["retried_as"]
else:
    sys.exit("The cell ended, without a result.")
