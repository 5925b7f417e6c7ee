"""What all spec models share."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat

Positive = PositiveFloat
NonNegative = Annotated[float, Field(ge=0.0)]
# Of odometry, per root of a metre travelled: beyond any robot's, and its squares are still numbers.
Drift = Annotated[float, Field(ge=0.0, le=1000.0)]
Ratio = Annotated[float, Field(ge=0.0, le=1.0)]


class Model(BaseModel):
    """Base of every spec model: frozen, nothing unknown, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
