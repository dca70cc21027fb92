"""What goes in and out over REST: SI units, finite numbers, no unknown field."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import ConfigDict, Field, model_validator

from station.config.controllers import ControllerFile
from station.config.motions import TipMotion
from station.config.strict import Strict, Vector
from station.lab.loads import Load
from station.service.solve import Stability
from web.access.identity import LONGEST_NAME
from web.access.tokens import Role
from web.api.messages import Act

TipMotionIn = Annotated[TipMotion, Field(discriminator="kind")]


class ErrorOut(Strict):
    """Why a request was refused."""

    error: str


REFUSED: dict[int | str, dict[str, Any]] = {
    403: {"model": ErrorOut, "description": "viewers, foreign hosts and pages of other sites"},
    409: {"model": ErrorOut, "description": "the present state, or another operator, does not allow it"},
    422: {"model": ErrorOut, "description": "a value is missing, unknown or out of range"},
}

CIRCLE = {"kind": "circle", "radius": 0.01, "period": 20.0, "normal": [0.0, 0.0, 1.0]}
CONTROLLER = {"strategy": "dual_layer", "k1": 2.5, "k2": 2.5, "feedforward": True}


class StartIn(Strict):
    """An experiment by name, or a free motion from where the robot is; what is left out is as set before."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"experiment": "fig10", "case": "feedforward"},
                {"trajectory": CIRCLE, "controller": CONTROLLER, "duration": 60.0},
            ]
        }
    )

    experiment: str | None = None
    """name of a preset, see `GET /api/experiments`"""
    case: str | None = None
    """of the experiment; the first when left out"""
    trajectory: TipMotionIn | None = None
    controller: ControllerFile | None = None
    load: Load | None = None
    """pull at the simulated tip"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)] | None = None
    """[s]"""

    @model_validator(mode="after")
    def _one_or_the_other(self) -> Self:
        free = any(value is not None for value in (self.trajectory, self.controller, self.load, self.duration))
        if self.experiment is not None and free:
            raise ValueError("give an experiment or trajectory, controller, load and duration, not both")
        if self.experiment is None and self.case is not None:
            raise ValueError("a case needs its experiment")
        return self


class StartOut(Strict):
    """A run that has begun."""

    run_id: str
    warnings: tuple[str, ...]
    """what a person should know about it: from when on its load is more than the joints can make up for, and why"""


class DoneOut(Strict):
    """The state after a request."""

    state: str
    note: str = ""
    """what a person should know about it"""


class RunOut(Strict):
    """The run that is on, or the last one."""

    id: str
    title: str
    phase: str
    """none, approaching, settling or moving"""
    progress: float
    """part of the motion that is done, 0 ... 1"""
    duration: float
    """of the motion [s]"""
    recorded: bool
    """it has, or will have, a recording; going to a pose has none"""
    recording: bool
    """it is being recorded, or its recording is being finished"""


class LoopOut(Strict):
    """How punctual the 500 Hz loop is, since it began."""

    ticks: int
    missed: int
    """whole periods skipped"""
    late_us: Mapping[str, float]
    """from the deadline to the start of the tick [us]: p50, p99, p99_9, max"""
    tick_us: Mapping[str, float]
    """length of a tick's work [us]"""
    scheduler: str


class DeviceOut(Strict):
    """One device's light."""

    severity: int
    """0 well, 1 worth a look, 2 a motion must not go on, 3 stopped, 4 fault"""
    condition: str
    """closed, connecting, homing, connected or fault"""
    text: str
    """what is wrong and what to do about it"""


class OperatorIn(Strict):
    """A wish to be operator."""

    name: str | None = Field(default=None, max_length=LONGEST_NAME)
    """shown to everybody; the sender's own when left out"""
    take_over: bool = False
    """also when somebody else is operator"""


class OperatorOut(Strict):
    """Who may command."""

    name: str | None
    """of the operator; null when there is none, and the next command makes its sender operator"""
    you: bool
    """it is the one who asks"""
    role: Role
    """of the one who asks: viewers can only look, and STOP"""
    lapses_s: float | None
    """after so long without a word from the operator anybody else may command [s]"""


class TouchOut(Strict):
    """A load that does not act at the tip."""

    force: Vector
    """world frame [N]"""
    place: float | None
    """on the shaft, arc length from the plate [m]; null: the geometry does not tell"""
    intervals: tuple[tuple[float, float], ...]
    """where it may be, 95 % [m]"""
    reason: str
    """why the place cannot be told; empty when it can"""


class StatusOut(Strict):
    """Everything at one look."""

    format: int
    """of REST: one more when a script that was written for the one before would misunderstand an answer"""
    state: str
    """OFF, CONNECTING, CONNECTED, HOMING, HOMED, READY, RUNNING, HOLD, STOPPED or FAULT"""
    cause: str
    """why it is HOLD, STOPPED or FAULT"""
    phase: str
    """of what is RUNNING: approaching, settling, moving or jogging; else none"""
    says: str
    """what is going on, for a person"""
    next: str
    """what to do next; empty when there is nothing to do"""
    act: Act
    """the command or the tab of the page that does what is next: connect, home, reset, start, calibrate; else empty"""
    operator: OperatorOut
    stale: bool
    """no tick for half a second: the values below are old"""
    age: float
    """since the last tick [s]"""
    lab: str
    """what is simulated"""
    warnings: tuple[str, ...]
    """of this computer, this robot and its load: real-time scheduling refused, tubes that snap, a touched shaft"""
    run: RunOut | None
    devices: Mapping[str, DeviceOut]
    loop: LoopOut
    joints: Mapping[str, float]
    """[rad or m]"""
    tip_measured: Vector | None
    """[m], world frame; null, as what follows, while nobody renews it: stages are homed, a device is silent"""
    tip_estimated: Vector | None
    """by the loaded model [m]"""
    tip_desired: Vector | None
    """[m]"""
    tip_true: Vector | None
    """simulated truth, virtual lab only [m]"""
    force: Vector | None
    """at the tip, from the base sensors [N]"""
    touch: TouchOut | None
    """where the load acts instead of the tip; null: at the tip, too small, or the robot moves too fast to tell"""


class FactOut(Strict):
    """One line of what a case does, in words with numbers and units."""

    what: str
    text: str


class CaseOut(Strict):
    """One case of an experiment."""

    name: str
    words: str
    """what it is, for a person"""
    duration: float
    """[s]"""
    strategy: str
    trajectory: str
    load: str
    robot: str
    """that it is for"""
    lab: str
    """that it is written for; it is carried out on this station's"""
    start: Mapping[str, float]
    """pose that the robot goes to first [rad or m]"""
    facts: tuple[FactOut, ...]
    """all of that in words, with numbers and units"""
    warnings: tuple[str, ...]
    """what is otherwise here than the case has it; from when on its load is more than the joints can make up for"""
    refused: str
    """why this station cannot carry it out; empty when it can"""


class ExperimentOut(Strict):
    """A preset."""

    name: str
    title: str
    cases: tuple[CaseOut, ...]
    error: str = ""
    """why its file is no experiment; it has no cases then"""


class SolveIn(Strict):
    """A question to the loaded model."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "joints": {"outer_rotation": 0.0, "inner_rotation": 1.5708, "inner_translation": -0.1},
                    "force": [0.2, 0.0, 0.0],
                }
            ]
        }
    )

    joints: Mapping[str, float]
    """all of them [rad or m]"""
    force: Vector = (0.0, 0.0, 0.0)
    """at the tip, world frame [N]"""
    moment: Vector = (0.0, 0.0, 0.0)
    """at the tip, world frame [N m]"""


class SolveOut(Strict):
    """The loaded model's answer."""

    tip: Vector
    """[m]"""
    joints: tuple[str, ...]
    """order of the Jacobian's columns"""
    jacobian: tuple[tuple[float, ...], ...]
    """3 x n [m/rad or m/m]"""
    compliance: tuple[tuple[float, ...], ...]
    """3 x 3 [m/N]"""
    iterations: int
    stability: Stability
    """whether the robot stays in this shape; under a moment at the tip, which has no energy, that may not be known"""
