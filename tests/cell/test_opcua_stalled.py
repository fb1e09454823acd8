"""An OPC UA server whose event loop stands still ends; no other server may be in this process, it would end, too."""

from __future__ import annotations

import asyncio
import queue
import time
from contextlib import closing

from bus.clock import WALL_CLOCK
from bus.threads import handled_by
from cell.opcua.stalled import LoopWatch


def test_a_loop_that_stands_still_is_a_defect() -> None:
    """It would notice no client's end, while the threads still say that their leases are attended."""
    defects: queue.SimpleQueue[str] = queue.SimpleQueue()

    async def run() -> None:
        with handled_by(lambda _name, defect: defects.put(str(defect))), closing(LoopWatch(WALL_CLOCK, 0.3)):
            await asyncio.sleep(0.5)
            assert defects.empty()
            time.sleep(0.8)
            assert "stands still" in defects.get(timeout=10)

    asyncio.run(run())
