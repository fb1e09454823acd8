"""Waits until a session knows who listens: what it publishes before that, nobody hears."""

from __future__ import annotations

import time

from bus.session import Bus
from bus.topics import ROOT, Topic


def await_listeners(bus: Bus, *topics: Topic) -> None:
    """Wait until another session subscribes to each of ``topics``, and this one knows it."""
    give_up_s = time.monotonic() + 60
    for topic in topics:
        while not bus.is_heard(f"{ROOT}/{bus.cell_id}/{topic.key}"):
            assert time.monotonic() < give_up_s, f"nobody listens to {topic.key}"
            time.sleep(0.002)
