"""What goes in and out over REST about calibration: SI units, finite numbers, no unknown field."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from station.calibration.catalogue import WEIGHTS
from station.config.strict import Strict

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


class CourseOut(Strict):
    """The procedure that is on, or the last one."""

    what: str
    on: bool
    """it has not ended"""
    stage: Literal["thinking", "moving", "asking", "done", "aborted", "failed"]
    done: float
    """part of it, 0 ... 1"""
    says: str
    """what is going on, or why it has ended"""
    asked: str
    """what a person is asked to do; empty when nothing"""
    hangs: float
    """known to hang at the tip, or to be hung there now [N]"""
    elapsed: float
    """[s]"""
    left: float
    """as expected [s]"""
    result: str
    """name of what was found; empty while there is nothing"""


class CalibrationOut(Strict):
    """What can be found out, and how it is getting on."""

    offers: tuple[OfferOut, ...]
    weights: tuple[float, ...]
    """usual known weights [N]"""
    robots: tuple[str, ...]
    """presets, for an exchange of tubes"""
    folder: str
    """where results go"""
    course: CourseOut | None


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


class UseOut(Strict):
    """How a result is put to use."""

    text: str
    line: str
    """at the top of the station's file; empty when there is none to be put there"""
    options: str
    """of ctr-station serve, for a station without a file"""


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
    use: UseOut


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


class TodoOut(Strict):
    """One line of the checklist."""

    procedure: str
    """to be carried out; empty: something that a person does"""
    text: str


class NowOut(Strict):
    """The procedure after a request."""

    course: CourseOut | None
