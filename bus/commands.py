"""What is asked of the cell and its nodes, and what they answer and report about themselves."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bus.arrays import Blob, Transform
from bus.frozen import Message

MAX_CYCLES = 1_000_000
"""Of one ``start``."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class CommandRequest(Message):
    """A command to the cell, sent as the payload of ``command/{verb}``.

    Attributes:
        command_id: chosen by the client; the same id sent twice acts once.
        client_id: who asks: a chunk of a Zenoh key; what moves the arm needs its liveliness token ``lease/{client_id}``
            (`cell.machine.leases`).
        cycles: ``start`` only: how many picks.
        until_empty: ``start`` only, instead of ``cycles``: until a pick finds nothing, or three in a row failed.
        object: ``pick`` in simulation only: name of the object to present; None = the next one.
    """

    command_id: Annotated[str, Field(max_length=100)] = ""
    client_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{0,100}$")] = ""
    cycles: Annotated[int, Field(ge=1, le=MAX_CYCLES)] = 1
    until_empty: bool = False
    object: Annotated[str, Field(max_length=100)] | None = None

    @model_validator(mode="after")
    def _cycles_or_until_empty(self) -> CommandRequest:
        if self.until_empty and self.cycles != 1:
            raise ValueError("a start runs so many cycles or until_empty, not both")
        return self


class CommandReply(Message):
    """The cell accepted a command. What it refuses, or cannot read, is answered with an `ErrorReply`.

    The fields that both have mean the same in both. ``cycle_id`` names the cycle that an accepted ``pick`` or ``start``
    begins; ``lease`` the client that holds the lease now: when that is lost, the cell holds.
    """

    ok: bool
    state: str
    code: str = ""
    reason: str = ""
    advice: str = ""
    available: tuple[str, ...] = ()
    cycle_id: str = ""
    lease: str = ""


class CellState(Message):
    """The machine's state (PackML names), published at every change and answered on ``state``."""

    state: str
    stage: str
    cycle_id: str
    since_ns: int
    available: tuple[str, ...]
    reason: str


class Event(Message):
    """Something a person should know; ``code`` is of `bus.codes.Code` or a short upper-case word."""

    code: str
    severity: Literal["info", "warning", "error"]
    text: str
    advice: str = ""


class LoopHealth(Message):
    """A loop of a node: how often it really runs (over the last 2 s), and how many of its rounds it has left out.

    ``fault``: the error its last round ended with, "" when it went well.
    """

    rate_hz: float
    target_hz: float
    missed: int
    fault: str = ""


class Health(Message):
    """A node about itself, once a second.

    Attributes:
        answered, failed: questions since its start. ``last_fault``: the newest error, "" without any.
        loops: by name, e.g. ``arm.state``.
        readings: what its devices report, e.g. ``camera.ir_temperature_c``.
        defects: owned threads that ended by an exception nobody foresaw.
    """

    name: str
    pid: int
    uptime_s: float
    answered: int
    failed: int
    last_fault: str = ""
    loops: dict[str, LoopHealth] = Field(default_factory=dict)
    readings: dict[str, float] = Field(default_factory=dict)
    defects: int = 0


class NodeHealth(Message):
    """A node as the cell sees it.

    Attributes:
        is_alive: its liveliness token is there. ``problems``: of this node; empty = healthy.
        restarts: how often its supervisor brought it back. ``said``: its newest word about itself.
    """

    is_alive: bool
    problems: tuple[str, ...]
    restarts: int
    said: Health | None


class CellHealth(Message):
    """The health of the whole cell, derived by the daemon: healthy when neither a node nor the daemon has a problem.

    ``defects``: threads of the daemon that ended by an exception nobody foresaw, each in a few words.
    """

    is_healthy: bool
    nodes: dict[str, NodeHealth]
    defects: tuple[str, ...] = ()


class ErrorReply(Message):
    """Why not: a refusal, or an error of `bus.errors`, as it travels in Zenoh's ``reply_err``.

    Attributes:
        ok: always false, so that one look at an answer of either kind tells.
        state: of the cell, where a command was refused. ``available``: what it would accept now.
        code: short reason, e.g. ``WRONG_STATE``. ``error``: the class of the error.
        reason: what happened. ``advice``: what to do about it.
    """

    ok: Literal[False] = False
    state: str = ""
    code: str
    reason: str
    advice: str = ""
    available: tuple[str, ...] = ()
    error: str = "CellError"


class Nothing(Message):
    """A request or answer without content."""


class Heartbeat(Message):
    """I am there: the cell to its nodes, and a client that holds the lease to the cell (every 0.2 s)."""


class ResultRequest(Message):
    """Asks for the result of one cycle."""

    cycle_id: Annotated[str, Field(max_length=100)]


class TopicSchema(Message):
    """One row of `bus.topics`. ``asks``, ``says``: the encodings of its question and of its payload or answer."""

    key: str
    kind: str
    acts: str
    asks: str
    says: str


class BusSchema(Message):
    """The bus as an API.

    Attributes:
        topics: every key, in the order of the table.
        json_schemas: by encoding; protobuf payloads are Foxglove's and have none here.
    """

    topics: tuple[TopicSchema, ...]
    json_schemas: dict[str, dict[str, Any]]


class Stranger(Message):
    """What a session that is not the cell's put on one of its keys; ``payload`` is cut after 64 KiB."""

    key: str
    encoding: str
    source: str
    payload: Blob


class HandMove(Message):
    """Open or close the fingers, without force."""

    width_m: Finite
    speed_m_s: Finite


class HandGrasp(Message):
    """Close until something is felt, and keep pressing."""

    force_n: Finite
    speed_m_s: Finite


class PresentRequest(Message):
    """Simulation only: put one object on the table. ``object`` None = the ``cycle``-th of a seeded order.

    Where the table was filled at the start (``sim.clutter``), it stays as it is, and an object by name is refused.
    """

    object: Annotated[str, Field(max_length=100)] | None
    cycle: int
    seed: int


class PresentedObject(Message):
    """Simulation only: one object, and where it really is, wherever that is."""

    name: str
    base_from_object: Transform


class Presented(Message):
    """Simulation only: every object of the cell - also what was delivered - and where it really is.

    `object` and `base_from_object` are those of the only one; ValueError where there are several.
    ``names``: of what could be presented; empty where that is not known.
    """

    objects: tuple[PresentedObject, ...]
    names: tuple[str, ...] = ()

    @property
    def object(self) -> str:
        return self._only.name

    @property
    def base_from_object(self) -> Transform:
        return self._only.base_from_object

    @property
    def _only(self) -> PresentedObject:
        (only,) = self.objects
        return only
