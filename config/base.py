"""What every setting is made of: frozen, unknown keys refused, numbers finite."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[Finite, Finite, Finite]
JointVector = tuple[Finite, Finite, Finite, Finite, Finite, Finite, Finite]
Chunk = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")]


UNSHOWN: Final = "unshown"
"""Type of a validation error whose input may be a secret: no message shows it."""


class Settings(BaseModel):
    """Base of all settings: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")
