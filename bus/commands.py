"""Requests to the cell and its nodes, their replies, and their reports about themselves. Units: SI (docs/frames.md)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bus.arrays import Blob, Transform
from bus.frozen import Message
from bus.messages.job import Job

MAX_CYCLES = 1_000_000
"""The most picks of one ``start``."""

UnitMode = Literal["Production", "Manual"]
"""PackML's modes of the unit."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class CommandRequest(Message):
    """A command to the cell, sent as the payload of ``command/{verb}``.

    Attributes:
        command_id: chosen by the client; the same id sent twice acts once.
        client_id: name of the client, one chunk of a Zenoh key. A command that moves the arm needs the client's
            liveliness token ``lease/{client_id}`` (`cell.machine.leases`).
        cycles: ``start`` only: the number of picks.
        until_empty: ``start`` only, instead of ``cycles``: until a pick finds nothing, or three in a row failed, or two
            that touched nothing.
        object: ``pick`` in simulation only: name of the object to present; None = the next one.
        proposal: ``approve``, ``next_grasp`` and ``reject`` only: the id of what is answered; ``approve`` must name it.
        mode: ``mode`` only. ``axis``, ``direction``: ``jog`` only, an axis of ``base`` and its sense, 1 or -1.
        reason: of ``reject`` and ``next_grasp``: why, in words.
        job: what every pick of a ``pick`` or ``start`` is to pick, and where to lay it; of ``cancel`` its ``job_id``
            alone counts.
    """

    command_id: Annotated[str, Field(max_length=100)] = ""
    client_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{0,100}$")] = ""
    cycles: Annotated[int, Field(ge=1, le=MAX_CYCLES)] = 1
    until_empty: bool = False
    object: Annotated[str, Field(max_length=100)] | None = None
    proposal: Annotated[str, Field(max_length=100)] = ""
    reason: Annotated[str, Field(max_length=300)] = ""
    mode: UnitMode | None = None
    axis: Literal["x", "y", "z"] | None = None
    direction: Literal[-1, 1] | None = None
    job: Job = Job()

    @model_validator(mode="after")
    def _cycles_or_until_empty(self) -> CommandRequest:
        if self.until_empty and self.cycles != 1:
            raise ValueError("a start runs so many cycles or until_empty, not both")
        return self


class CommandReply(Message):
    """The cell accepted a command. A refused or unreadable command is answered with an `ErrorReply`.

    Attributes:
        ok, state, code, reason, advice, available: as in `ErrorReply`.
        cycle_id: the cycle that an accepted ``pick`` or ``start`` begins, now or when it is its turn.
        lease: the client that now holds the lease; when it is lost, the cell holds.
        job_id: of the accepted job: the client's, or the cycle's id if it named none.
        position: in the queue, from 1 on; 0 = it begins now.
        since_ns: when the state began that the command led to, or a later one, UTC; as in `CellState`.
    """

    ok: bool
    state: str
    code: str = ""
    reason: str = ""
    advice: str = ""
    available: tuple[str, ...] = ()
    cycle_id: str = ""
    lease: str = ""
    job_id: str = ""
    position: int = 0
    since_ns: int = 0


class CellState(Message):
    """The machine's state (PackML names), published at every change and answered on ``state``.

    Attributes:
        state: PackML name, e.g. ``Execute``.
        stage: the stage of the running cycle, or the motion by hand; "" where none runs.
        cycle_id: the open cycle.
        since_ns: when this state or stage began, UTC.
        available: the commands accepted now.
        reason: why the machine is in this state; of Stopped and Aborted also that something may be in the hand.
        mode: of the unit: it picks, or is moved by hand.
        job_id: the job that the cell works at; "" for none. ``queue``: the ids of those that wait, the next one first.
        asked_by: the client that asked for the job, or for the open cycle; "" = nobody.
    """

    state: str
    stage: str
    cycle_id: str
    since_ns: int
    available: tuple[str, ...]
    reason: str
    job_id: str = ""
    queue: tuple[str, ...] = ()
    asked_by: str = ""
    mode: UnitMode = "Production"


class Event(Message):
    """A report for the operator.

    Attributes:
        code: one of `bus.codes.Code`, or a short upper-case word.
        severity: how urgent it is.
        text: what happened. ``advice``: what to do about it; "" = nothing.
    """

    code: str
    severity: Literal["info", "warning", "error"]
    text: str
    advice: str = ""


class LoopHealth(Message):
    """The health of one loop of a node.

    Attributes:
        rate_hz: measured over the last 2 s.
        target_hz: configured.
        missed: rounds left out since the start.
        fault: the error that ended its last round; "" when that succeeded.
    """

    rate_hz: float
    target_hz: float
    missed: int
    fault: str = ""


class Health(Message):
    """A node's report about itself, once a second.

    Attributes:
        name: of the node. ``pid``: of its process. ``uptime_s``: since its start.
        answered, failed: queries since its start. ``last_fault``: the newest error; "" without any.
        loops: by name, e.g. ``arm.state``.
        readings: device readings by name, e.g. ``camera.ir_temperature_c``.
        defects: owned threads that ended by an unforeseen exception.
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
    """The daemon's view of a node.

    Attributes:
        is_alive: its liveliness token is there. ``problems``: of this node; empty = healthy.
        restarts: how often its supervisor restarted it. ``said``: its newest `Health`.
    """

    is_alive: bool
    problems: tuple[str, ...]
    restarts: int
    said: Health | None


class DoorHealth(Message):
    """The daemon's view of a door.

    Attributes:
        endpoint: where it is open; "" while it is not.
        problem: why it is not open; "" when it is, or has yet to open for the first time. ``advice``: what to do.
    """

    endpoint: str = ""
    problem: str = ""
    advice: str = ""


class CellHealth(Message):
    """The health of the whole cell, derived by the daemon: healthy when nothing in it has a problem.

    Attributes:
        is_healthy: nothing in it has a problem.
        nodes: by node name. ``doors``: those that the cell opened, by name.
        defects: threads of the daemon that ended by an unforeseen exception, each in a few words.
    """

    is_healthy: bool
    nodes: dict[str, NodeHealth]
    defects: tuple[str, ...] = ()
    doors: dict[str, DoorHealth] = Field(default_factory=dict)

    @property
    def problems(self) -> list[str]:
        """Everything that is wrong, each in a few words; empty = healthy."""
        nodes = [f"{name}: {problem}" for name, node in self.nodes.items() for problem in node.problems]
        doors = [f"{name}: {door.problem}" for name, door in self.doors.items() if door.problem]
        return [*nodes, *doors, *self.defects]


class ErrorReply(Message):
    """A refusal, or an error of `bus.errors`, as it travels in Zenoh's ``reply_err``.

    Attributes:
        ok: always false, so that one field tells an error from an accepted command.
        state: of the cell, where a command was refused. ``available``: the commands it would accept now.
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
    """A request or reply without content."""


class Heartbeat(Message):
    """A sign of life, every 0.2 s: from the cell to its nodes, and from the client that holds the lease to the cell."""


class ResultRequest(Message):
    """Request for the result of one cycle.

    Attributes:
        cycle_id: of a ``pick`` or ``start``, from its reply.
    """

    cycle_id: Annotated[str, Field(max_length=100)]


class TopicSchema(Message):
    """One row of `bus.topics`.

    Attributes:
        key: below the cell's root.
        kind: ``publish``, ``query``, or ``alive``, a liveliness token.
        acts: who may ask, where the answer is an act: a ``client`` that names itself, or the ``cell``; "" = it reads.
        asks, says: the encodings of its query, and of its payload or answer.
    """

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
    """A payload that a session other than the topic's publisher put on a key of the cell; cut after 64 KiB.

    Attributes:
        payload: the first bytes of it.
        key, encoding: as it was published.
        source: the session that published it.
    """

    key: str
    encoding: str
    source: str
    payload: Blob


class HandMove(Message):
    """Open or close the fingers to a width, without force control.

    Attributes:
        width_m: distance between the finger pads.
        speed_m_s: rate of the width, both fingers together.
    """

    width_m: Finite
    speed_m_s: Finite


class HandGrasp(Message):
    """Close the fingers until they touch an object, and keep pressing.

    Attributes:
        force_n: grasping force.
        speed_m_s: rate of the width, both fingers together.
    """

    force_n: Finite
    speed_m_s: Finite


class PresentRequest(Message):
    """Simulation only: put one object on the table.

    Where the table was filled at the start (``sim.clutter``), it stays as it is, and an object by name is refused.

    Attributes:
        cycle: number of the cycle, from 0 on. ``seed``: of the order and the poses.
        object: its name; None = the ``cycle``-th of the order that ``seed`` gives.
    """

    object: Annotated[str, Field(max_length=100)] | None
    cycle: int
    seed: int


class PresentedObject(Message):
    """Simulation only: one object and its true pose.

    Attributes:
        name: as `PresentRequest` names it.
        base_from_object: (4, 4) pose of the object's own origin in ``base`` [m].
    """

    name: str
    base_from_object: Transform


class Presented(Message):
    """Simulation only: every object of the cell, delivered ones included, and its true pose.

    Attributes:
        objects: each with its pose.
        names: of the objects that can be presented; empty where that is not known.
    """

    objects: tuple[PresentedObject, ...]
    names: tuple[str, ...] = ()

    @property
    def object(self) -> str:
        """Name of the only object. Raises: ValueError where there are several or none."""
        return self._only.name

    @property
    def base_from_object(self) -> Transform:
        """Pose (4, 4) of the only object in ``base`` [m]. Raises: ValueError where there are several or none."""
        return self._only.base_from_object

    @property
    def _only(self) -> PresentedObject:
        (only,) = self.objects
        return only
