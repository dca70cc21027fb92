"""What goes in and out over REST about calibration: SI units, finite numbers, no unknown field."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from station.calibration.catalogue import WEIGHTS
from station.calibration.results import Use
from station.config.strict import Strict
from station.service.calibration_session import Report

What = Literal["axes", "latency", "tracker", "force", "tubes"]
#: Of a known weight [N].
Weight = Annotated[float, Field(ge=0.02, le=2.0)]


class OfferOut(Strict):
    """A procedure that can be begun."""

    name: str
    title: str
    sentence: str
    """when, and what happens"""
    needs: str
    """what a person has to have at hand"""
    seconds: float
    """of robot time with the usual poses and weights, persons' work included [s]"""
    weight_seconds: float
    """for each weight, included in `seconds` [s]"""
    scales: bool
    """an effort other than 1 means more or fewer poses"""
    weighs: bool
    """it asks for known weights"""


class CalibrationOut(Strict):
    """What can be found out, and how it is getting on."""

    offers: tuple[OfferOut, ...]
    weights: tuple[float, ...]
    """usual known weights [N]"""
    robots: tuple[str, ...]
    """presets, for an exchange of tubes"""
    folder: str
    """where results go"""
    course: Report | None


class CalibrateIn(Strict):
    """A procedure, and a person's word."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"what": "tracker", "effort": 1.0, "way_is_clear": True}]}
    )

    what: What
    effort: Annotated[float, Field(ge=0.5, le=5.0)] = 1.0
    """so many times the usual number of poses"""
    weights: Annotated[tuple[Weight, ...], Field(strict=False, min_length=1, max_length=4)] = WEIGHTS
    """that there are to hang at the tip [N]"""
    way_is_clear: Literal[True]
    """somebody has looked: the tubes can move through their whole workspace without touching anything"""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len(set(self.weights)) < len(self.weights):
            raise ValueError("the weights must differ")
        return self


class KeptOut(Strict):
    """An earlier calibration at one look."""

    name: str
    procedure: str
    title: str
    made: str
    """ISO 8601"""
    bench: str
    simulated: bool
    """devices and robot were a virtual lab's"""
    findings: tuple[str, ...]
    """in words"""


class KeptDetailsOut(KeptOut):
    """An earlier calibration with its numbers."""

    found: tuple[Mapping[str, str], ...]
    """name, before, found, interval: half of 95 %"""
    visits: int
    robot_s: float
    """of robot time [s]"""
    files: tuple[str, ...]
    use: Use


class ExchangeIn(Strict):
    """The robot with other tubes: a preset, or what its file says."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"robot": "three_tubes"}]})

    robot: str | None = None
    """preset"""
    file: Annotated[str, Field(max_length=50_000)] | None = None
    """text of a robot's .toml file"""

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.robot is None) == (self.file is None):
            raise ValueError("give either robot or file")
        return self


class NowOut(Strict):
    """The procedure after a request."""

    course: Report | None
