"""Workers of a Dask cluster that is there (``vlad-cell[cluster]``). Dask is imported when it is asked for.

Whoever reaches a Dask scheduler can run programs on its workers: it belongs on a network of its own, or on ``tls://``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import Any

from bus.distribution import OURS
from bus.errors import CellUnreachable, ConfigError
from cell.workers.local import LocalWorkers
from cell.workers.work import TRIES, ItemT, ResultT, WorkerLost, lost

_PATIENCE_S = 10.0
_APART = 2
"""More than one, so that it is never this process that dies."""


@dataclass(frozen=True)
class ClusterWorkers:
    """The workers of the scheduler at an address, e.g. ``tcp://10.0.0.5:8786``."""

    address: str

    def __post_init__(self) -> None:
        """Raises: ConfigError when Dask is not installed."""
        _distributed()

    def run(
        self, work: Callable[[ItemT], ResultT], items: Sequence[ItemT]
    ) -> Iterator[tuple[int, ResultT | WorkerLost]]:
        """As `Workers.run`; results are released as they come, so that a death recomputes none of them.

        Raises: CellUnreachable when nobody answers; ConfigError when a worker has another version of this program.
        """
        distributed = _distributed()
        try:
            client = distributed.Client(self.address, timeout=_PATIENCE_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise CellUnreachable(
                f"No Dask scheduler answers at {self.address}.", "Start it, or leave out --scheduler."
            ) from error
        suspects: list[int] = []
        with client:
            numbers = {client.submit(_told, work, item, pure=False): index for index, item in enumerate(items)}
            for future in distributed.as_completed([*numbers]):
                found = _result(distributed, future)
                future.release()
                if isinstance(found, WorkerLost):
                    suspects.append(numbers[future])
                else:
                    yield numbers[future], found
        # Dask blames all that waited on a worker that died; a process of this machine for each one is certain.
        for number, tried in LocalWorkers(_APART).run(work, [items[index] for index in suspects]):
            yield suspects[number], tried


def _result(distributed: Any, future: Any) -> Any:
    try:
        version, result = future.result()
    except distributed.KilledWorker:
        return lost(TRIES + 1)
    if version != _version():
        raise ConfigError(
            f"A worker of the cluster runs version {version} of this program, not {_version()}.",
            "Install the same on all of them: another version may decide otherwise.",
        )
    return result


def _told(work: Callable[[Any], Any], item: Any) -> tuple[str, Any]:
    return _version(), work(item)


def _version() -> str:
    return metadata.version(OURS)


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise ConfigError("Dask is not installed.", "uv pip install 'vlad-cell[cluster]'") from error
