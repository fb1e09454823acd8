"""The OPC UA door of a running cell: one process that joins the cell as a client, and serves it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, closing, suppress

from cell import client
from cell.client import client_name
from cell.nodes.loop_watch import LoopWatch, ended_by_defect
from cell.nodes.process import freeze_gc
from cell.opcua import packml
from cell.opcua.address_space import NAMESPACE, AddressSpace
from cell.opcua.calls import Calls
from cell.opcua.mirror import HEARS, Mirror
from cell.opcua.server import CellServer, quieten_logs
from config.clock import clock_of
from config.schema import Station

_CLOSE_S = 2.0


def serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    """Serve the running cell until the end (`cell.nodes.door_child.Serve`).

    Raises: CellUnreachable without a cell; ConfigError for certificates or users; PortOccupied.
    """
    asyncio.run(_serve(station, tell, wait_for_end))


async def _serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    waiting = ThreadPoolExecutor(1, "opcua-end")
    try:
        async with opened(station) as (endpoint, mirroring):
            with freeze_gc(), ended_by_defect(), closing(LoopWatch(clock_of(station), "opcua")):
                tell(endpoint)
                end = asyncio.wrap_future(waiting.submit(wait_for_end))
                done, _ = await asyncio.wait({end, mirroring}, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()  # a mirror that ended did so by an exception
    finally:
        waiting.shutdown(wait=False, cancel_futures=True)


@asynccontextmanager
async def opened(station: Station) -> AsyncIterator[tuple[str, asyncio.Future[None]]]:
    """An open server on this event loop: its endpoint, and the task that keeps it up to date. Raises: as `serve`."""
    quieten_logs()
    settings = station.opcua
    with client.connect(station, HEARS, client_id=client_name("opcua")) as viewer:
        server = CellServer(settings)
        await server.prepare(station.cell_id)
        indices = [await server.register_namespace(uri) for uri in (packml.NAMESPACE, NAMESPACE)]
        space = AddressSpace(server, *indices)
        await space.build(station.cell_id)
        calls, mirror = Calls(station, space, viewer), Mirror(space, viewer)
        await mirror.begin()
        endpoint = await server.open(calls)
        mirroring = asyncio.create_task(mirror.run())
        try:
            yield endpoint, mirroring
        finally:
            mirroring.cancel()
            with suppress(TimeoutError):
                await asyncio.wait_for(server.stop(), _CLOSE_S)
            mirror.close()
            calls.close()
