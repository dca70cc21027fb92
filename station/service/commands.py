"""Commands that the station process executes or plans, and the list of all commands.

A planned command first checks its values, then permit and state, and then its motion on the model, which is slow.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from core.control.reachability import check_pose
from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, turn_bounds
from core.errors import Unreachable
from station.config.controllers import DEFAULT_CONTROLLER, ControllerFile, default_controller
from station.config.loads import Load, NoLoad, force_of
from station.config.motions import HoldMotion, Orders, TipMotion, suited
from station.config.robots import named_pose
from station.config.strict import Strict, preset_names
from station.control.commands import (
    Command,
    Connect,
    HomeStages,
    Jog,
    RequestError,
    Reset,
    SetStiffness,
    Stop,
    StreamPose,
    Tare,
)
from station.control.states import RefusedError, State, Transition, origins
from station.control.task import MotionTask, StreamLimits
from station.experiments.case_summary import case_words, motion_title
from station.experiments.experiment import load_warnings, offered_experiment
from station.lab.faults import LabFault, check_faults
from station.service.feasibility import (
    WORKING_POSE_HINT,
    check_path,
    deviations_from_case,
    displaced_joints,
    excessive_force,
    goto_joints,
    goto_working_pose,
    incompatibility,
    missing_target,
    suggest_motion,
)
from station.service.permits import Permit
from station.service.runs import RunRequest, StartRequest

if TYPE_CHECKING:
    from station.service.supervisor import Supervisor

#: Component of a displacement of the tip by `goto` [m]; it is small, because `goto` plans no path of the tip.
Displacement = Annotated[float, Field(ge=-0.02, le=0.02)]
#: Coordinate of the tip [m]; the bound only excludes values in a wrong unit.
Coordinate = Annotated[float, Field(ge=-1.0, le=1.0)]
#: Longest duration of a motion [s].
MAX_DURATION_S = 86400.0
EXAMPLE_MOTION = {"kind": "circle", "radius": 0.01, "period": 20.0, "normal": [0.0, 0.0, 1.0]}
EXAMPLE_CONTROLLER = {"strategy": "dual_layer", "k1": 2.5, "k2": 2.5, "feedforward": True}


class StationCommand(Command):
    """Command that the station process executes; it sends the motions that it has planned to the control process."""

    @abstractmethod
    def execute(self, station: "Supervisor", permit: Permit) -> RunRequest | None:
        """Execute the command; return the run that it has started.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the command.
            CtrError: the command is not possible on this station; the text has the reason.
        """


class MotionSettings(Strict):
    """Settings of the next free motion, which is a motion that is not part of an experiment."""

    trajectory: Annotated[TipMotion, Field(discriminator="kind")] = HoldMotion()
    controller: ControllerFile = DEFAULT_CONTROLLER
    load: Load = NoLoad()
    """load on the simulated tip; without effect on real devices"""
    duration: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] = 60.0
    """duration of the motion [s]"""

    def changed_by(self, start: "Start") -> "MotionSettings":
        """Return a copy of the settings with the values that the command `start` contains."""
        given = {key: value for key in type(self).model_fields if (value := getattr(start, key)) is not None}
        return self.model_copy(update=given)


class Start(StationCommand):
    """Start a named experiment, or a free motion from the present pose; omitted fields use the current settings."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"experiment": "fig10", "case": "feedforward"},
                {"trajectory": EXAMPLE_MOTION, "controller": EXAMPLE_CONTROLLER, "duration": 60.0},
            ]
        }
    )
    name = "start"
    states = origins(Transition.START)
    moves = starts_run = True

    experiment: str | None = None
    """name of a preset, see `GET /api/experiments`"""
    case: str | None = None
    """case of the experiment; null: the first"""
    trajectory: Annotated[TipMotion, Field(discriminator="kind")] | None = None
    controller: ControllerFile | None = None
    load: Load | None = None
    """load on the simulated tip"""
    duration: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] | None = None
    """duration of the motion [s]"""

    @model_validator(mode="after")
    def _experiment_or_motion(self) -> Self:
        free = any(value is not None for value in (self.trajectory, self.controller, self.load, self.duration))
        if self.experiment is not None and free:
            raise ValueError("give either an experiment, or trajectory, controller, load and duration")
        if self.experiment is None and self.case is not None:
            raise ValueError("case is given without experiment; add the experiment's name")
        return self

    def execute(self, station: "Supervisor", permit: Permit) -> RunRequest:
        """Check the motion on the model and start it."""
        if self.experiment is None:
            start = self._motion(station, permit)
        else:
            start = experiment_start(station, self.experiment, self.case, permit)
        return station.start(start, permit)

    def _motion(self, station: "Supervisor", permit: Permit) -> StartRequest:
        """Return the start request of a free motion."""
        settings = station.settings.changed_by(self)
        orders = Orders(settings.trajectory, station.robot)
        if orders.follow is not None and (missing := missing_target(station.bench)):
            raise RequestError(f"{settings.trajectory.kind}: {missing}")
        controller = station.bench.controlled(suited(settings.controller, settings.trajectory))
        if excessive := excessive_force(orders.press, station.bench):
            raise RequestError(f"{settings.trajectory.kind}: {excessive}")
        task = MotionTask(controller, orders, settings.duration)
        check_load(station, settings.load)
        station.check(self.name, self.states, permit)
        joints = station.status().values["joints"]
        try:
            orders.check(task.controller, joints, task.duration)
        except Unreachable as error:
            instead = suggest_motion(settings.trajectory, task.controller, joints, task.duration) or WORKING_POSE_HINT
            raise Unreachable(f"{error}; {instead}") from None
        return StartRequest(
            task=task,
            title=motion_title(settings.trajectory, settings.load),
            load=settings.load,
            warnings=load_warnings(orders, task.controller, joints, task.duration, settings.load),
            about={"settings": settings.model_dump(mode="json")},
        )


def experiment_start(
    station: "Supervisor", name: str, case: str | None = None, permit: Permit | None = None
) -> StartRequest:
    """Return the start request of a case on this rig; None: the first case. The robot moves to the start pose first.

    The present lab or devices are used; deviations from the case are shown as warnings and recorded. Without `permit`
    the station's state is not checked.

    Raises:
        RequestError: the preset or case does not exist, or is for another robot.
        VoidError: a STOP or a reset came after the request, or the permit has expired.
        RefusedError: the state does not allow the motion.
    """
    if name not in preset_names("experiments"):
        raise RequestError(f"'{name}' is not one of the experiments: {', '.join(preset_names('experiments'))}")
    bench = station.bench
    if permit is not None:
        station.check(Start.name, Start.states, permit)  # refuse before the slow check of every case
    experiment = offered_experiment(name, bench.robot_name)
    chosen = experiment.cases[0] if case is None else next((c for c in experiment.cases if c.name == case), None)
    if chosen is None:
        raise RequestError(f"'{case}' is not one of the cases of {name}: {', '.join(c.name for c in experiment.cases)}")
    if refused := incompatibility(chosen, bench):
        raise RequestError(f"{name}, case {chosen.name}: {refused}")
    differs = deviations_from_case(chosen, bench)
    controller = bench.controlled(suited(chosen.file.controller, chosen.file.trajectory))
    about = {
        "experiment": name,
        "case": chosen.name,
        "settings": {**chosen.file.model_dump(mode="json"), "lab": bench.lab_name},
        "otherwise": list(differs),
        "source": experiment.source,
    }
    return StartRequest(
        task=MotionTask(controller, chosen.orders, chosen.file.duration, chosen.start),
        title=f"{name.replace('_', ' ')}: {case_words(chosen, experiment.title)}",
        load=chosen.file.load,
        faults=tuple(chosen.file.faults),
        counted_from=chosen.file.counted_from,
        warnings=(*differs, *chosen.warnings),
        about=about,
    )


class StreamAgreement(StationCommand):
    """Start a motion from the present pose whose setpoints a client streams; omitted options have their defaults."""

    name = "start"
    states = origins(Transition.START)
    moves = starts_run = True

    frame: Literal["start", "world"] = "start"
    """frame of the positions: relative to the tip at the start, or the world frame"""
    speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """largest speed of the setpoint [m/s]"""
    acceleration: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """largest acceleration of the setpoint [m/s^2]"""
    turning: Annotated[float, Field(gt=0.0, le=1.0)] = 0.2
    """largest turning rate of the direction setpoint, if the controller's task includes the direction [rad/s]"""
    reach: Annotated[float, Field(gt=0.0, le=0.2)] = 0.05
    """largest distance from the tip at the start; positions farther away are refused [m]"""
    silence: Annotated[float, Field(ge=0.05, le=2.0)] = 0.2
    """time without a message after which the tip comes to rest [s]"""
    end: Annotated[float, Field(ge=0.5, le=60.0)] = 2.0
    """time without a message after which the run ends [s]"""
    duration: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] = 600.0
    """longest duration of the run [s]"""
    controller: ControllerFile | None = None
    """null: the best one for the station's devices"""

    def limits(self) -> StreamLimits:
        """Return the limits of the stream for the control loop."""
        bounds = replace(
            DEFAULT_MOTION_BOUNDS, max_speed=self.speed, max_acceleration=self.acceleration, reach=self.reach
        )
        return StreamLimits(bounds, self.silence, self.end, turn_bounds(self.turning))

    @property
    def controls_direction(self) -> bool:
        """Whether the direction of the tip is controlled, so that a client may send it."""
        return self.controller is not None and self.controller.task != "position"

    def execute(self, station: "Supervisor", permit: Permit) -> RunRequest:
        """Check the controller and the present pose, and start the run."""
        file = self.controller or default_controller(station.bench.present)
        task = MotionTask(station.bench.controlled(file), self.limits(), self.duration)
        values = station.status().values
        if "joints" in values:
            check_pose(task.controller.statics, task.controller.limits, values["joints"])
            task.controller.check_loops(values["joints"])
        settings = {
            "controller": file.model_dump(mode="json"),
            "duration": self.duration,
            "stream": self.model_dump(mode="json", exclude={"controller"}),
        }
        start = StartRequest(task, "streamed setpoints", load=None, about={"settings": settings})
        return station.start(start, permit)


class Home(StationCommand):
    """Home every stage, then go to the working pose if there is one; the operator confirms that the path is clear."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"way_is_clear": True}]})
    name = "home"
    states = origins(Transition.HOME)
    moves = True

    way_is_clear: Literal[True]
    """the operator has checked that the tubes can be retracted and turned without touching anything"""
    then_working_pose: bool = True
    """true: after homing go to the working pose, if the robot's file has one; false: stay at the homing pose"""

    def execute(self, station: "Supervisor", permit: Permit) -> RunRequest | None:
        """Home the stages; a run to the working pose follows."""
        station.check(self.name, self.states, permit)
        if self.then_working_pose and station.bench.robot.working_pose is not None:
            return station.start(goto_working_pose(station.bench), permit, home=True)
        station.command_control(HomeStages(), permit)
        return None


class Goto(StationCommand):
    """Go to a joint pose; each joint moves at most at half of its top speed, and all arrive together."""

    model_config = ConfigDict(json_schema_extra={"examples": [{}, {"joints": {"inner_translation": -0.08}}]})
    name = "goto"
    states = origins(Transition.START)
    moves = starts_run = True

    joints: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """joint positions by name [rad or m]; omitted joints do not move; null: the working pose of the robot's file"""
    by: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """instead of `joints`: displacements of joints by name [rad or m]"""
    tip: Annotated[tuple[Displacement, Displacement, Displacement], Field(strict=False)] | None = None
    """instead of `joints`: displacement of the tip, world frame [m]"""
    place: Annotated[tuple[Coordinate, Coordinate, Coordinate], Field(strict=False)] | None = None
    """instead of `joints`: goal of the measured tip, world frame [m]; without a tracker: of the model's tip"""

    @model_validator(mode="after")
    def _only_one(self) -> Self:
        if sum(one is not None for one in (self.joints, self.by, self.tip, self.place)) > 1:
            raise ValueError("give only one of joints, by, tip and place")
        return self

    def execute(self, station: "Supervisor", permit: Permit) -> RunRequest:
        """Check that the tubes do not snap on the path, and start the run."""
        station.check(self.name, self.states, permit)
        bench, status = station.bench, station.status()
        now, names = status.values["joints"], station.robot.joint_names
        last = None if status.run is None else status.run.start.task
        # The joints stop slightly before their goal. A step starts from the last goal, so errors do not add up.
        at = last.start if last is not None and not last.rests and last.approach(now) is None else None
        at = now if at is None else at
        force = np.nan_to_num(status.values["force_filtered"])
        if self.tip is not None:
            target = displaced_joints(bench, at, force, np.array(self.tip))
            start = goto_joints(bench, target, "by a step of the tip")
        elif self.place is not None:
            # Displace the model's tip as far as the measured tip, because the model's error is about the same there.
            tip = status.values["tip_measured" if bench.present.tracker else "tip_estimated"]
            if not np.isfinite(tip).all():
                raise RefusedError("the tip is not measured now, so its distance from `place` is unknown")
            offset = np.array(self.place) - tip
            start = goto_joints(bench, displaced_joints(bench, at, force, offset, "place"), "to a place")
        elif self.by is not None:
            by = named_pose(dict.fromkeys(names, 0.0) | dict(self.by), bench.robot, "by")
            start = goto_joints(bench, at + by, f"by a step of {', '.join(self.by)}")
        elif self.joints is None:
            start = goto_working_pose(bench)
        else:
            known = dict(zip(names, now.tolist(), strict=True))
            target = named_pose(known | dict(self.joints), bench.robot, "joints")
            what = "to a pose" if len(self.joints) == len(known) else f"to {', '.join(self.joints)}"
            start = goto_joints(bench, target, what)
        check_path(bench, start, now)
        return station.start(start, permit)


class ServoJoints(StationCommand):
    """Move the joints toward a pose for 0.3 s; repeat the request, with the same or another pose, to continue."""

    name = "servo"
    states = StreamPose.states
    moves = True

    joints: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=20)]
    """positions of all joints in their order [rad or m]"""

    def execute(self, station: "Supervisor", permit: Permit) -> None:
        """Check the pose and the path to it as `Goto` does, and send it to the loop."""
        station.check(self.name, self.states, permit)
        start = goto_joints(station.bench, np.array(self.joints), "to a streamed pose")
        check_path(station.bench, start, station.status().values["joints"])
        station.command_control(StreamPose(self.joints), permit)


class Mark(StationCommand):
    """Mark the present moment of the run in its recording."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"text": "touched the tip"}]})
    name = "mark"
    states = (State.RUNNING,)

    text: Annotated[str, Field(min_length=1, max_length=200)] = "marked"
    """what has happened, for example: touched the tip"""

    def execute(self, station: "Supervisor", permit: Permit) -> None:  # noqa: ARG002 - nothing moves
        """Write the mark."""
        station.runs.mark(self.text)


class ApplyLoad(StationCommand):
    """Apply a load to the simulated tip or shaft now, until the next motion."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"load": {"kind": "constant", "magnitude": 0.2}}]})
    name = "load"
    states = tuple(State)
    needs_lab = True

    load: Load

    def execute(self, station: "Supervisor", permit: Permit) -> None:  # noqa: ARG002 - nothing moves
        """Check that the load acts on the robot, and apply it."""
        check_load(station, self.load)
        station.lab.apply_load(self.load)


class InjectFaults(StationCommand):
    """Inject faults into the simulated devices, effective immediately."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"faults": [{"kind": "mute", "device": "tracker", "duration": 1.0}]}]}
    )
    name = "faults"
    states = tuple(State)
    needs_lab = True

    faults: Annotated[tuple[LabFault, ...], Field(strict=False, min_length=1, max_length=20)]

    def execute(self, station: "Supervisor", permit: Permit) -> None:  # noqa: ARG002 - nothing moves
        """Check the names of the devices, and inject the faults."""
        check_faults(self.faults, station.bench.robot)
        station.lab.inject(self.faults)


class ClearFaults(StationCommand):
    """Remove all injected faults of the simulated devices."""

    name = "faults"
    states = tuple(State)
    method = "DELETE"
    needs_lab = True

    def execute(self, station: "Supervisor", permit: Permit) -> None:  # noqa: ARG002 - nothing moves
        """Remove the faults."""
        station.lab.inject(())


def check_load(station: "Supervisor", load: Load) -> None:
    """Check that a load acts on the robot's shaft and that a custom load returns a force.

    Raises:
        PoseError: the load acts beyond the last tube end.
    """
    force_of(load, 0.0)
    values = station.status().values
    if math.isfinite(load.contact) and "joints" in values:
        station.robot.check_contact(values["joints"], load.contact)


#: Every command of REST; routes, the documents' table and checks of the Python client are made from this list. It
#: contains neither `StreamAgreement`, the first message of a stream, nor calibrations, which consist of many runs.
COMMANDS: tuple[type[Command], ...] = (
    Connect, Home, Tare, Start, Goto, Jog, SetStiffness, Mark, Stop, Reset, ApplyLoad, InjectFaults, ClearFaults,
)  # fmt: skip
