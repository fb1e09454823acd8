"""Lets a cell pick once over OPC UA, with plain asyncua only. Usage: python opcua_client.py [endpoint [JOB]]

JOB: a job as JSON, {"target": {"text": "the largest"}}; or a colour: what shows it most is picked by its pixel.
"""

import asyncio
import json
import sys
from typing import Any

from asyncua import Client, Node, ua


class Heard:
    """The messages of the subscription: states and results, in order."""

    def __init__(self) -> None:
        self.states: asyncio.Queue[str] = asyncio.Queue()
        self.results: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def datachange_notification(self, _node: Node, value: str, _data: Any) -> None:
        self.states.put_nowait(value)

    def event_notification(self, event: Any) -> None:
        self.results.put_nowait(json.loads(event.Json))


async def pick(endpoint: str, job: str = "") -> dict[str, Any]:
    """The result of one pick; what is thrown names the refusal."""
    client = Client(endpoint)
    client.session_timeout = 5000  # [ms]; the cell grants no more (opcua.session_timeout_s), and asyncua would tell so
    async with client:  # the lease is the session's: when this program ends or dies, the cell holds
        ours = await client.get_namespace_index("urn:vlad-cell:opcua")
        cell = client.get_node(f"ns={ours};s=Cell")

        async def call(method: str, *arguments: Any) -> Any:
            try:
                return await cell.call_method(ua.NodeId(f"Cell.{method}", ours), *arguments)
            except ua.UaStatusCodeError as refusal:
                why = [client.get_node(f"ns={ours};s=Cell.LastRefusal.{name}") for name in ("Code", "Reason", "Advice")]
                raise SystemExit(
                    f"{method}: {refusal}: {' '.join([await node.read_value() for node in why])}"
                ) from None

        heard = Heard()
        subscription = await client.create_subscription(50, heard)
        state = client.get_node(f"ns={ours};s=Cell.Status.StateName")
        await subscription.subscribe_data_change(state, queuesize=100)  # every state, not only the newest
        base = client.get_node(ua.ObjectIds.BaseEventType)
        await subscription.subscribe_events(cell, [await base.get_child(f"{ours}:ResultEvent")])

        now = await heard.states.get()
        if now in ("Stopped", "Complete"):
            await call("Reset")
        while now != "Idle":
            now = await heard.states.get()
            print(now)
        if job and not job.startswith("{"):
            from pixel import pixel_of  # type: ignore[import-not-found] # noqa: PLC0415 - the file beside this one, where it is asked for

            png, _taken_at, stamp = await call("Picture")
            pixel = await asyncio.to_thread(pixel_of, png, job)  # the session goes on meanwhile
            job = json.dumps({"target": {"pixel": pixel, "picture_ns": int(stamp)}})
        cycle_id, job_id, position = await call("PickJob", job)
        print(f"cycle {cycle_id} of job {job_id}, {position} before it")
        while (result := await heard.results.get())["cycle_id"] != cycle_id or result["retried_as"]:
            if result["cycle_id"] == cycle_id:
                cycle_id = result["retried_as"]
        return result


if __name__ == "__main__":
    given = sys.argv[1:] or ["opc.tcp://127.0.0.1:4840/cell"]
    try:
        print(asyncio.run(pick(*given)))
    except OSError as error:
        sys.exit(f"Nobody answers at {given[0]}: {error}. Does the cell run, with opcua.enabled?")
    except ua.UaError as error:  # it wants a certificate or a user, say
        sys.exit(f"{given[0]} refuses: {error}")
    except ValueError as error:
        sys.exit(f"There is no target: {error}.")
