"""Settings of the cell's communication, on this machine and beyond it."""

from __future__ import annotations

from pydantic import field_validator, model_validator

from bus.secured import is_encrypted, is_loopback
from config.base import Seconds, Settings, SystemPath
from config.endpoints import require_endpoint


class BusSettings(Settings):
    """Communication of the cell's processes: on loopback; beyond it, with certificates and access control.

    The times below are wall time where anything is real. In a simulation on one machine they are computing time, which
    passes as slowly as the machine is busy (`config.clock`).

    Attributes:
        endpoint: where programs find the cell. The cell's own is on loopback; another machine's file names the cell's
            `listen`, or the router.
        listen: where the cell listens for other machines, e.g. ``tls/192.168.1.10:7448``.
        router: a Zenoh router that the cell joins, e.g. ``tls/192.168.1.5:7447``; it need not be up yet.
        zenoh: the Zenoh file that secures endpoints beyond loopback, relative to the station file; it must contain:
            docs/security.md.
        ask_timeout_s: how long a query waits for its reply.
        stale_s: a node whose arm or hand publishes nothing for so long is lost, whatever else it does.
        silence_s: longest silence while something moves, of the cell towards its arm and of the client that holds the
            lease towards the cell; after it the arm brakes on its path. A simulation that runs as fast as it can
            (``sim.pace = 0``) waits for ``stale_s``.
        frozen_s: a node of this machine that publishes nothing at all for so long is killed and restarted.
    """

    endpoint: str = "tcp/127.0.0.1:7447"
    listen: str | None = None
    router: str | None = None
    zenoh: SystemPath | None = None
    ask_timeout_s: Seconds = 5.0
    stale_s: Seconds = 0.75
    silence_s: Seconds = 0.5
    frozen_s: Seconds = 3.0

    @field_validator("endpoint", "listen", "router")
    @classmethod
    def _loopback_or_encrypted(cls, endpoint: str | None) -> str | None:
        if endpoint is None:
            return None
        require_endpoint(endpoint)
        if not is_loopback(endpoint) and not is_encrypted(endpoint):
            raise ValueError(
                "only loopback endpoints like tcp/127.0.0.1:7447 are accepted in the clear; beyond, tls/ADDRESS:PORT"
            )
        return endpoint

    @model_validator(mode="after")
    def _beyond_loopback_only_with_a_file(self) -> BusSettings:
        beyond = [one for one in (self.endpoint, self.listen, self.router) if one and not is_loopback(one)]
        if beyond and self.zenoh is None:
            raise ValueError(
                f"{beyond[0]} is beyond loopback and needs bus.zenoh, a file with certificates and access control: "
                "`cell keys` writes one, see docs/security.md"
            )
        return self
