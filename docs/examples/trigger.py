"""Triggers one pick from any program: plain eclipse-zenoh, nothing of ours. Usage: python trigger.py [cell_id]"""

import json
import sys

import zenoh

cell = f"cell/{sys.argv[1] if len(sys.argv) > 1 else 'sim'}"
config = zenoh.Config.from_json5(
    '{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}, scouting: {multicast: {enabled: false}}}'
)
with zenoh.open(config) as session, session.declare_subscriber(f"{cell}/cycle/result") as results:
    for verb in ("reset", "pick"):
        for reply in session.get(f"{cell}/command/{verb}", payload="{}", encoding="application/json", timeout=5):
            answer = json.loads((reply.ok or reply.err).payload.to_string())
            print(verb, "->", answer)
        while verb == "reset" and "Resetting" in session.get(f"{cell}/state").recv().ok.payload.to_string():
            pass
    if answer.get("ok"):
        print("result ->", json.loads(results.recv().payload.to_string()))
