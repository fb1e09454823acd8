"""One or two examples of every command, shown below its help and in docs/commands.md. Each is tried by a test."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "start": ("cell start --cycles 5 --seed 3", "cell start --config config/lab.toml --http"),
    "pick": ("cell pick", "cell pick --target 'the largest red one' --place 0.46,0.45,0.12"),
    "run": ("cell run --cycles 5", "cell run --until-empty"),
    "reset": ("cell reset", "cell reset --config config/lab.toml"),
    "stop": ("cell stop",),
    "abort": ("cell abort",),
    "clear": ("cell clear",),
    "hold": ("cell hold",),
    "unhold": ("cell unhold",),
    "suspend": ("cell suspend",),
    "unsuspend": ("cell unsuspend",),
    "cancel": ("cell cancel order-17",),
    "approve": ("cell approve",),
    "next-grasp": ("cell next-grasp",),
    "reject": ("cell reject 'too near the edge'",),
    "mode": ("cell mode manual", "cell mode production"),
    "jog": ("cell jog z+ --steps 4",),
    "jog-home": ("cell jog-home",),
    "hand-open": ("cell hand-open",),
    "hand-close": ("cell hand-close",),
    "status": ("cell status", "cell status --json"),
    "watch": ("cell watch", "cell watch --once"),
    "fleet": ("cell fleet --endpoint tls/192.168.1.5:7447 --set bus.zenoh=viewer.json5",),
    "router": ("cell router --config router.json5",),
    "keys": ("cell keys ~/vlad-keys --host 192.168.1.10",),
    "cycles": ("cell cycles --failed", "cell cycles --summary --day today"),
    "query": ("cell query 'SELECT code, count(*) FROM cycles GROUP BY code'",),
    "label": ("cell label 20261129T161544565 good", "cell label 20261129T161544565 'the light was off'"),
    "show": ("cell show 20261129T161544565",),
    "report": ("cell report recordings/2026-11-29/20261129T161544565.mcap", "cell report recordings"),
    "replay": (
        "cell replay recordings --workers 2",
        "cell replay cycle.mcap --set perception.align=pca_cfopt",
    ),
    "compare": ("cell compare 20261129T161544565 20261129T161545892 -o page.html", "cell compare before since"),
    "alike": ("cell alike 20261129T161544565",),
    "groups": ("cell groups --failed",),
    "recover": ("cell recover recordings",),
    "catalogue": ("cell catalogue rebuild",),
    "catalogue rebuild": ("cell catalogue rebuild",),
    "prune": ("cell prune --dry-run", "cell prune"),
    "export": ("cell export lerobot recordings -o picks",),
    "export lerobot": ("cell export lerobot recordings -o picks --where \"result = 'SUCCESS'\"",),
    "export grasps": ("cell export grasps recordings -o grasps",),
    "config": ("cell config new mine.toml", "cell config check mine.toml"),
    "config show": ("cell config show verify", "cell config show --changed -c config/lab.toml"),
    "config check": ("cell config check config/lab.toml",),
    "config diff": ("cell config diff config/sim.toml config/bin.toml",),
    "config schema": ("cell config schema > station.schema.json",),
    "config new": ("cell config new mine.toml", "cell config new mine.toml --simulated"),
    "doctor": ("cell doctor", "cell doctor --config config/lab.toml"),
    "detectors": ("cell detectors",),
    "drivers": ("cell drivers",),
    "calibrate": ("cell calibrate board -o board.png",),
    "calibrate board": ("cell calibrate board -o board.png",),
    "calibrate hand-eye": ("cell calibrate hand-eye --set sim.board=true --dry-run",),
    "calibrate check": ("cell calibrate check --config config/lab.toml",),
    "fault": ("cell fault camera off", "cell fault camera none"),
    "opcua": ("cell opcua",),
    "http": ("cell http --config config/lab.toml",),
    "node": ("cell node camera --config config/lab.toml",),
}
"""By command, and by the command of a group. Numbers of cycles and files are made up."""


def shown(name: str) -> str | None:
    """The examples of a command as they stand below its help; None without."""
    lines = EXAMPLES.get(name)
    return None if lines is None else "\n".join(("\b", "Examples:", *(f"  {line}" for line in lines)))
