"""Triggers one pick from any program: plain eclipse-zenoh, nothing of ours. Usage: python trigger.py [cell_id]"""

import json
import sys
import time

import zenoh

client_id = "trigger"
cell = f"cell/{sys.argv[1] if len(sys.argv) > 1 else 'sim'}"
config = '{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}, scouting: {multicast: {enabled: false}}}'


def ask(key: str) -> dict:
    payload = {"client_id": client_id} if key.startswith("command") else {}
    reply = session.get(f"{cell}/{key}", payload=json.dumps(payload), timeout=5).recv()
    return json.loads((reply.ok or reply.err).payload.to_string())


with zenoh.open(zenoh.Config.from_json5(config)) as session:
    # The lease: while this token lives the arm may move for us; when this program ends or hangs, the cell holds.
    lease = session.liveliness().declare_token(f"{cell}/lease/{client_id}")
    results = session.declare_subscriber(f"{cell}/cycle/result")
    print("reset ->", ask("command/reset")["reason"] or "accepted")
    while ask("state")["state"] == "Resetting":
        time.sleep(0.1)
    print("pick ->", answer := ask("command/pick"))
    if answer["ok"]:
        print("result ->", json.loads(results.recv().payload.to_string()))
