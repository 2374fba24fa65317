"""Distributions as a campaign file states them, and draws from them.

5.0, "left"                          always this
{choose = ["left", "right"]}         one of them, all alike or by `weights`
{low = 0.1, high = 0.6}              uniform; with `scale = "log"` uniform in the logarithm
{mean = 1.0, deviation = 0.05}       normal
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
from pydantic import Field

from softbot.toml_file import STRICT

Plain = bool | int | float | str


class Choose(pydantic.BaseModel):
    """One of some values."""

    model_config = STRICT

    choose: tuple[Any, ...] = Field(min_length=1, description="values, one of which is taken")
    weights: tuple[float, ...] | None = Field(None, description="how often each is taken, over the sum of all")

    @pydantic.model_validator(mode="after")
    def _fit(self) -> Self:
        if self.weights is not None:
            if len(self.weights) != len(self.choose):
                raise ValueError(f"{len(self.weights)} weights for {len(self.choose)} values; give one for each")
            if min(self.weights) < 0.0 or not sum(self.weights) > 0.0:
                raise ValueError("weights: must not be negative, nor all zero")
        return self

    def draw(self, random: np.random.Generator) -> Any:
        """One of them."""
        weights = None if self.weights is None else np.array(self.weights) / sum(self.weights)
        return self.choose[int(random.choice(len(self.choose), p=weights))]


class Span(pydantic.BaseModel):
    """Anything from low to high."""

    model_config = STRICT

    low: float = Field(description="the least")
    high: float = Field(description="the most")
    scale: Literal["linear", "log"] = Field("linear", description="log: uniform in the logarithm")

    @pydantic.model_validator(mode="after")
    def _fit(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low = {self.low:g} is above high = {self.high:g}; exchange them")
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError(f'low = {self.low:g}: scale = "log" needs numbers above zero')
        return self

    def draw(self, random: np.random.Generator) -> float:
        """A number from low to high."""
        if self.scale == "log":
            return float(math.exp(random.uniform(math.log(self.low), math.log(self.high))))
        return float(random.uniform(self.low, self.high))


class Normal(pydantic.BaseModel):
    """A normal distribution."""

    model_config = STRICT

    mean: float
    deviation: float = Field(ge=0, description="standard deviation")

    def draw(self, random: np.random.Generator) -> float:
        """A number about the mean."""
        return float(random.normal(self.mean, self.deviation))


def _which(value: Any) -> str:
    if not isinstance(value, dict):
        return "choose" if isinstance(value, Choose) else type(value).__name__.lower()
    for key, name in (("choose", "choose"), ("mean", "normal"), ("deviation", "normal")):
        if key in value:
            return name
    return "span"


Spread = Annotated[
    Annotated[Choose, pydantic.Tag("choose")]
    | Annotated[Span, pydantic.Tag("span")]
    | Annotated[Normal, pydantic.Tag("normal")],
    pydantic.Discriminator(
        _which,
        custom_error_type="distribution",
        custom_error_message="input should be {choose = […]}, {low = …, high = …} or {mean = …, deviation = …}",
    ),
]
"""Any of the distributions that are no plain value."""


def _varied(value: Any) -> Any:
    return "spread" if isinstance(value, dict | Choose | Span | Normal) else "plain"


Drawn = Annotated[
    Annotated[Spread, pydantic.Tag("spread")] | Annotated[Plain, pydantic.Tag("plain")],
    pydantic.Discriminator(_varied),
]
"""A plain value or a distribution."""


def drawn(value: Any, random: np.random.Generator) -> Any:
    """A plain value as it is, a distribution's next draw."""
    return value.draw(random) if isinstance(value, Choose | Span | Normal) else value
