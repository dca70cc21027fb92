"""Base class of all configuration models, and the types of their numbers and vectors.

One class describes a table of a file, a REST request and the object in the program, so each key is declared once.
"""

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


class Strict(BaseModel):
    """Base of every configuration model: frozen; rejects unknown keys, NaN, infinity and text in place of a number."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
# Files and requests have arrays where the models have tuples; their items are still checked strictly.
Row = Field(strict=False)
Vector = Annotated[tuple[float, float, float], Row]


def _has_length(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not 1e-9 <= math.hypot(*direction) <= 1e9:
        raise ValueError("the length of a direction must be 1e-9 ... 1e9")
    return direction


#: Direction in the world frame; its length does not matter, but must not be zero.
Direction = Annotated[Vector, AfterValidator(_has_length)]
#: Largest coordinate of a position [m]: far longer than any robot, and small enough that its square does not overflow.
MAX_COORDINATE_M = 1000.0


def _near(position: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(map(abs, position)) > MAX_COORDINATE_M:
        raise ValueError(f"each coordinate of a position must be at most {MAX_COORDINATE_M:g} m, positive or negative")
    return position


#: Position in the world frame, or offset from another position [m].
Position = Annotated[Vector, AfterValidator(_near)]
