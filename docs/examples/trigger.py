"""Triggers one pick from any program: plain eclipse-zenoh, nothing of ours. Usage: python trigger.py [cell_id]"""

import json
import sys
import time

import zenoh

cell = f"cell/{sys.argv[1] if len(sys.argv) > 1 else 'sim'}"
config = '{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}, scouting: {multicast: {enabled: false}}}'


def ask(key: str) -> dict:
    reply = session.get(f"{cell}/{key}", payload="{}", timeout=5).recv()
    return json.loads((reply.ok or reply.err).payload.to_string())


with zenoh.open(zenoh.Config.from_json5(config)) as session:
    results = session.declare_subscriber(f"{cell}/cycle/result")
    print("reset ->", ask("command/reset")["reason"] or "accepted")
    while ask("state")["state"] == "Resetting":
        time.sleep(0.1)
    print("pick ->", answer := ask("command/pick"))
    if answer["ok"]:
        print("result ->", json.loads(results.recv().payload.to_string()))
