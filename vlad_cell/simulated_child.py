"""``python -m vlad_cell.simulated_child``: a simulated cell as the child of `simulated_cell`, until its stdin closes.

Its stdin closes with its parent, however that ends, so no simulated cell outlives the program that started it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from bus.frozen import Message
from bus.topics import Topic
from cell.build import running_cell
from cell.cli.serving.doors import open_doors, wanted_doors
from cell.nodes.door_child import serve_supervised
from config.schema import Station


def _serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    with (
        running_cell(station, _ignore) as daemon,
        open_doors(station, wanted_doors(station), daemon.publisher.publish_event),
    ):
        tell(station.bus.endpoint)
        wait_for_end()


def _ignore(_topic: Topic, _message: Message | bytes) -> None:
    """The terminal of this process belongs to its parent; clients hear everything over the bus."""


if __name__ == "__main__":
    sys.exit(serve_supervised(_serve))
