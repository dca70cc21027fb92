"""Request and response types of the REST interface, in SI units. NaN, infinity and unknown fields are refused."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from core.model.statics import Integrator
from station.config.motions import TipMotion
from station.config.strict import Strict, Vector
from station.service.solve import Stability
from web.access.identity import MAX_NAME_CHARS, Role

TipMotionIn = Annotated[TipMotion, Field(discriminator="kind")]
#: Command or tab of the page that does what the status recommends.
Action = Literal["", "connect", "home", "reset", "start", "calibrate"]


class ErrorOut(Strict):
    """Why a request was refused."""

    error: str


REFUSED_RESPONSES: dict[int | str, dict[str, Any]] = {
    403: {"model": ErrorOut, "description": "the client is a viewer, a foreign host or a page of another site"},
    409: {"model": ErrorOut, "description": "not allowed in the present state, or another client is operator"},
    422: {"model": ErrorOut, "description": "a value is missing, unknown or out of range"},
}


class StartOut(Strict):
    """A run that has started."""

    run_id: str
    warnings: tuple[str, ...]
    """warnings for the operator, for example the time from which the load exceeds what the joints can compensate"""


class DoneOut(Strict):
    """The state after a request."""

    state: str
    note: str = ""
    """message for the operator; empty if there is nothing to report"""


class StopOut(DoneOut):
    """The state after a STOP."""

    confirmed: bool
    """true: every axis is at rest, and `note` is information; false: use the emergency stop if anything moves"""


class StopCheckOut(Strict):
    """Whether a STOP of the client would be accepted; otherwise its request is refused."""

    accepted: bool
    """always true"""


class RunOut(Strict):
    """The current run, or the last one."""

    id: str
    title: str
    phase: str
    """none, approaching, settling or moving"""
    progress: float
    """completed part of the motion, 0 ... 1"""
    duration: float
    """duration of the motion [s]"""
    load: str
    """load on the simulated tip; empty: none, or attached by hand"""
    desired_force: Vector | None
    """largest force that the tip shall exert on an obstacle, world frame [N]; null: the motion does not press"""
    recorded: bool
    """whether the run has, or will have, a recording; a motion to a pose has no recording"""
    recording: bool
    """whether the run is being recorded, or its recording is being finalised"""
    stiffness: tuple[tuple[float | None, ...], ...] | None = None
    """stiffness at each point of a palpation, row by row [N/m]; null: not known yet"""


class LoopOut(Strict):
    """Timing of the 500 Hz control loop since the loop started."""

    ticks: int
    missed: int
    """number of skipped periods"""
    late_us: Mapping[str, float]
    """delay of the tick's start after its deadline [us]: p50, p99, p99_9, max"""
    tick_us: Mapping[str, float]
    """work time of a tick [us]: p50, p99, p99_9, max"""
    scheduler: str


class DeviceOut(Strict):
    """Indicator of one device."""

    severity: int
    """0: good; 1: warning; 2: a motion must not continue; 3: stopped; 4: fault"""
    condition: str
    """closed, connecting, homing, connected or fault"""
    text: str
    """what is wrong with the device and what to do"""


class OperatorIn(Strict):
    """A request to become operator."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "Anna", "take_over": False}]})

    name: str | None = Field(default=None, max_length=MAX_NAME_CHARS)
    """shown to all clients; null: the sender's name"""
    take_over: bool = False
    """true: take over control even if another client is operator"""


class OperatorOut(Strict):
    """The operator, as one client sees it."""

    name: str | None
    """the operator's name; null: there is no operator, and the sender of the next command becomes operator"""
    you: bool
    """whether the requesting client is operator"""
    role: Role
    """role of the requesting client; a viewer may only view and press STOP"""
    lapses_s: float | None
    """time until the lease expires if the operator sends no request [s]"""


class ContactOut(Strict):
    """A load that does not act at the tip."""

    force: Vector
    """force of the load, world frame [N]"""
    position: float | None
    """arc length on the shaft from the plate [m]; null: the geometry does not determine it"""
    intervals: tuple[tuple[float, float], ...]
    """intervals that contain the position with 95 % confidence [m]"""
    reason: str
    """why the position is unknown; empty if the position is known"""


class StatusOut(Strict):
    """Status of the station."""

    format: int
    """format number of REST; it increases when a script for the previous format would misunderstand a response"""
    state: str
    """OFF, CONNECTING, CONNECTED, HOMING, HOMED, READY, RUNNING, HOLD, STOPPED or FAULT"""
    cause: str
    """human-readable cause of the state HOLD, STOPPED or FAULT"""
    details: str
    """device, address, raw values and load that belong to `cause` or `message`; empty if there are none"""
    phase: str
    """while RUNNING: approaching, settling, moving or jogging; otherwise none"""
    message: str
    """human-readable state, or the cause"""
    next: str
    """what the operator should do next; empty if nothing"""
    action: Action
    """command or tab of the page that does what `next` says: connect, home, reset, start, calibrate; otherwise empty"""
    operator: OperatorOut
    stale: bool
    """true: the control loop has sent no values for half a second, so the values below are stale"""
    age: float
    """time since the last tick [s]"""
    lab: str
    """name of the virtual lab, or the drivers in use"""
    simulated: bool
    """true: at least one device is simulated, by a virtual lab or by its own report"""
    warnings: tuple[str, ...]
    """warnings, for example: real-time scheduling is refused, tubes snap, a load acts on the shaft"""
    model: str
    """integrator of the controller's model, and length of its sub-links"""
    max_force: float
    """force on the tip at which a motion ends in HOLD, or the tip moves no further against the force [N]"""
    run: RunOut | None
    devices: Mapping[str, DeviceOut]
    loop: LoopOut
    joints: Mapping[str, float]
    """joint positions by name [rad or m]"""
    tip_measured: Vector | None
    """tip by the tracker, world frame [m]; this and the following values are null while stale: during homing or while
    a device is silent"""
    tip_estimated: Vector | None
    """tip by the loaded model [m]"""
    tip_desired: Vector | None
    """desired tip [m]"""
    tip_true: Vector | None
    """true tip of the simulated robot, virtual lab only [m]"""
    direction_measured: Vector | None
    """direction of the tip by the tracker, unit vector, world frame; all directions are null if only the position is
    controlled"""
    direction_observed: Vector | None
    """direction of the tip, estimated from tracker and model"""
    direction_desired: Vector | None
    """desired direction of the tip"""
    direction_true: Vector | None
    """true direction of the simulated robot's tip, virtual lab only"""
    force: Vector | None
    """force at the tip, estimated from the base sensors, or without them from the deflection [N]"""
    contact: ContactOut | None
    """load that acts on the shaft; null: the load acts at the tip or is too small, or the robot moves too fast"""


class FactOut(Strict):
    """One setting of a case as human-readable text, with numbers and units."""

    what: str
    text: str


class CaseOut(Strict):
    """One case of an experiment."""

    name: str
    words: str
    """human-readable description"""
    duration: float
    """duration of the motion [s]"""
    strategy: str
    trajectory: str
    load: str
    robot: str
    """robot of the case"""
    lab: str
    """virtual lab that the experiment's file names; the station runs the case in the station's own lab"""
    start: Mapping[str, float]
    """start pose [rad or m]"""
    facts: tuple[FactOut, ...]
    """all settings as human-readable facts"""
    warnings: tuple[str, ...]
    """settings in which this station differs from the case; the time from which the load exceeds what the joints can
    compensate"""
    refused: str
    """why this station cannot run the case; empty if the station can run it"""


class ExperimentOut(Strict):
    """An experiment that the station offers."""

    name: str
    title: str
    cases: tuple[CaseOut, ...]
    error: str = ""
    """error of an invalid experiment file, for which `cases` is empty"""
    group: Literal["paper", "station", "mine"]
    """experiment of the paper, other experiment of the station, or file of the user"""
    checked: bool
    """true: the motions were checked on the model; otherwise `error`, `warnings` and `refused` may still change"""


class SolveIn(Strict):
    """A query of the loaded model."""

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
    """positions of all joints by name [rad or m]"""
    force: Vector = (0.0, 0.0, 0.0)
    """force at the tip, world frame [N]"""
    moment: Vector = (0.0, 0.0, 0.0)
    """moment at the tip, world frame [N m]"""


class SolveOut(Strict):
    """Solution of the loaded model."""

    tip: Vector
    """position of the tip, world frame [m]"""
    direction: Vector
    """direction of the tip, unit vector, world frame"""
    ends: Mapping[str, Vector]
    """position of every tube's end, world frame [m]; the tip is the end of the innermost tube"""
    joints: tuple[str, ...]
    """order of the Jacobian's columns"""
    jacobian: tuple[tuple[float, ...], ...]
    """derivative of the tip with respect to the joints, 3 x n [m/rad or m/m]"""
    compliance: tuple[tuple[float, ...], ...]
    """derivative of the tip with respect to the force, 3 x 3 [m/N]"""
    iterations: int
    stability: Stability
    """whether the shape is stable; this may be unknown if a moment acts at the tip, because a moment has no potential
    energy"""
    integrator: Integrator
    """method that computed the shape; it follows from the tubes unless the robot's file requests the paper's method"""
    sublink: float
    """length of the integrator's steps [m]"""
