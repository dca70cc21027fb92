"""Request and response types of the calibration routes, in SI units. NaN, infinity and unknown fields are refused."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from station.calibration.catalogue import DEFAULT_WEIGHTS_N
from station.calibration.results import CalibrationUse
from station.config.strict import Strict
from station.service.calibration_session import SessionReport

What = Literal["axes", "latency", "tracker", "force", "tubes"]
#: A known weight to hang at the tip [N].
Weight = Annotated[float, Field(ge=0.02, le=2.0)]


class ProcedureOut(Strict):
    """A procedure that can be started."""

    name: str
    title: str
    sentence: str
    """when to use the procedure, and what it does"""
    needs: str
    """equipment that the operator needs"""
    seconds: float
    """duration with the default poses and weights, including manual steps [s]"""
    weight_seconds: float
    """part of `seconds` for each weight [s]"""
    scales: bool
    """whether `effort` changes the number of poses"""
    weighs: bool
    """whether the procedure needs known weights"""


class CalibrationOut(Strict):
    """Available procedures, and the progress of the running one."""

    offers: tuple[ProcedureOut, ...]
    weights: tuple[float, ...]
    """default weights [N]"""
    robots: tuple[str, ...]
    """names of the preset robots, from which an exchange of tubes can select"""
    folder: str
    """folder that contains the results"""
    course: SessionReport | None


class CalibrateIn(Strict):
    """A procedure to start, and the operator's confirmation."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"what": "tracker", "effort": 1.0, "way_is_clear": True}]}
    )

    what: What
    effort: Annotated[float, Field(ge=0.5, le=5.0)] = 1.0
    """factor on the default number of poses"""
    weights: Annotated[tuple[Weight, ...], Field(strict=False, min_length=1, max_length=4)] = DEFAULT_WEIGHTS_N
    """weights that the operator will hang at the tip [N]"""
    way_is_clear: Literal[True]
    """the operator has checked that the tubes can move through their whole workspace without touching anything"""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len(set(self.weights)) < len(self.weights):
            raise ValueError("the weights must differ")
        return self


class StoredCalibrationOut(Strict):
    """Summary of a stored calibration."""

    name: str
    procedure: str
    title: str
    made: str
    """time of the calibration, ISO 8601"""
    bench: str
    simulated: bool
    """whether a virtual lab simulated devices and robot"""
    findings: tuple[str, ...]
    """human-readable results"""


class StoredCalibrationDetailsOut(StoredCalibrationOut):
    """A stored calibration with its numbers."""

    found: tuple[Mapping[str, str], ...]
    """one entry per parameter: name, value before, value found, interval (half width of the 95 % interval)"""
    visits: int
    robot_s: float
    """time for which the procedure used the robot [s]"""
    files: tuple[str, ...]
    use: CalibrationUse


class ExchangeIn(Strict):
    """The robot with other tubes: the name of a preset, or the text of a robot file."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"robot": "three_tubes"}]})

    robot: str | None = None
    """name of a preset robot"""
    file: Annotated[str, Field(max_length=50_000)] | None = None
    """text of a robot's .toml file"""

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.robot is None) == (self.file is None):
            raise ValueError("give either robot or file")
        return self


class CalibrationNowOut(Strict):
    """State of the procedure after a request."""

    course: SessionReport | None
