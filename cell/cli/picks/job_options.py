"""The options of a job: ``--target``, ``--place`` and so on; the same for ``cell pick`` and ``cell run``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from bus.first_mistake import first_mistake
from bus.messages import Place, Target
from bus.messages.job import place_at

JobId = Annotated[str, typer.Option("--job", help="Your name for the job: in state, result and recording.")]
TargetText = Annotated[
    str | None, typer.Option("--target", help="The object in words, like 'the largest red one'.", show_default=False)
]
Pixel = Annotated[
    str | None, typer.Option("--pixel", help="The object at U,V of the picture.", metavar="U,V", show_default=False)
]
BoxPx = Annotated[
    str | None,
    typer.Option("--box", help="The object in a box of the picture.", metavar="U0,V0,U1,V1", show_default=False),
]
PointM = Annotated[
    str | None,
    typer.Option("--point", help="The object at a point in base [m].", metavar="X,Y,Z", show_default=False),
]
PlaceAt = Annotated[
    str | None,
    typer.Option(
        "--place",
        help="Where it is laid: a name of scene.places, or the tcp in base [m] and its heading [rad].",
        metavar="NAME|X,Y,Z[,YAW]",
        show_default=False,
    ),
]
DeadlineS = Annotated[
    float | None, typer.Option("--deadline-s", help="No grasp begins after so many seconds.", show_default=False)
]
MaxForce = Annotated[float | None, typer.Option("--max-force", help="Largest grasping force [N].", show_default=False)]
FromAbove = Annotated[bool, typer.Option("--from-above", help="Only grasps that come from above.")]
ClearWay = Annotated[bool, typer.Option("--clear-way", help="Pick what lies on the target first.")]
Queue = Annotated[bool, typer.Option("--queue", help="While the cell works, wait for its turn.")]


@contextmanager
def wrong_option_named() -> Iterator[None]:
    """Context in which a job is made of options. Raises: typer.BadParameter, which names the wrong one."""
    try:
        yield
    except ValidationError as error:
        raise typer.BadParameter(f"{first_mistake(error)}.") from error


def target_of(text: str | None, pixel: str | None, box: str | None, point: str | None) -> Target | None:
    """Return the target that the options name. Raises: typer.BadParameter; pydantic.ValidationError."""
    named: dict[str, Any] = {
        "text": text, "pixel": _numbers("--pixel", pixel, 2), "box": _numbers("--box", box, 4),
        "point_m": _numbers("--point", point, 3),
    }  # fmt: skip
    return Target(**named) if any(value is not None for value in named.values()) else None


def place_of(text: str | None) -> Place | None:
    """Return the place that ``--place`` names. Raises: typer.BadParameter; pydantic.ValidationError."""
    if text is None:
        return None
    if "," not in text:
        return Place(name=text)
    return place_at(_numbers("--place", text, 3, 4) or ())


def _numbers(option: str, text: str | None, *counts: int) -> tuple[float, ...] | None:
    """The numbers of ``1.0,2``. Raises: typer.BadParameter when they are not as many as ``counts`` allow."""
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{option} {text!r}: numbers with commas between, without spaces.") from error
    if len(numbers) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise typer.BadParameter(f"{option} {text!r}: {wanted} numbers are needed, these are {len(numbers)}.")
    return numbers
