"""Execute the requests of operators and scripts to a running station, after a check before anything moves."""

import math
import threading
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field

from core.control.reachability import check_pose
from core.control.setpoint_request import SetpointRequest
from core.errors import CtrError, Unreachable
from station.config.controllers import DEFAULT_CONTROLLER, ControllerFile, default_controller
from station.config.loads import Load, NoLoad, force_of
from station.config.motions import HoldMotion, Orders, TipMotion, suited
from station.config.robots import named_pose
from station.config.strict import Strict, preset_names
from station.control.states import Transition
from station.control.task import MotionTask, Space, StreamRequest
from station.experiments.case_summary import case_words, motion_title
from station.experiments.experiment import load_warnings, offered_experiment
from station.recording.run_outcome import counted_from, settling_time
from station.service.feasibility import (
    WORKING_POSE_HINT,
    check_path,
    deviations_from_case,
    excessive_force,
    goto_joints,
    goto_working_pose,
    incompatibility,
    missing_target,
    suggest_motion,
)
from station.service.permits import Permit
from station.service.runs import RunRequest, StartRequest
from station.service.setpoint_stream import StreamAgreement
from station.service.supervisor import Supervisor

#: Largest speed of the tip while jogging [m/s].
JOG_TIP_SPEED_M_S = 0.010
#: Largest turning rate of the tip's direction while jogging [rad/s].
JOG_TURN_SPEED_RAD_S = 0.1


class RequestError(CtrError):
    """A request is invalid in every state of the station."""


class StationSettings(Strict):
    """Settings of the next free motion, which is a motion that is not part of an experiment."""

    trajectory: Annotated[TipMotion, Field(discriminator="kind")] = HoldMotion()
    controller: ControllerFile = DEFAULT_CONTROLLER
    load: Load = NoLoad()
    """load on the simulated tip; without effect on real devices"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)] = 60.0
    """duration of the motion [s]"""


class StationService:
    """Service that starts experiments and free motions on one station."""

    def __init__(self, supervisor: Supervisor) -> None:
        self.supervisor = supervisor
        self._settings = StationSettings(controller=default_controller(supervisor.bench.present))
        self._lock = threading.Lock()

    @property
    def settings(self) -> StationSettings:
        """Settings of the next free motion."""
        with self._lock:
            return self._settings

    def set_trajectory(self, trajectory: TipMotion) -> None:
        """Set the trajectory of the next free motion."""
        with self._lock:
            self._settings = self._settings.model_copy(update={"trajectory": trajectory})

    def set_controller(self, controller: ControllerFile) -> None:
        """Set the controller of the next free motion.

        Raises:
            DescriptionError: the strategy is unknown, or a gain or bandwidth is out of range.
        """
        self.supervisor.bench.controlled(controller)
        with self._lock:
            self._settings = self._settings.model_copy(update={"controller": controller})

    def start_motion(
        self,
        trajectory: TipMotion | None = None,
        controller: ControllerFile | None = None,
        load: Load | None = None,
        duration: float | None = None,
        *,
        permit: Permit | None = None,
    ) -> RunRequest:
        """Start a free motion from the present pose; arguments that are None use the present settings.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the motion.
            CtrError: the motion or the controller is not possible.
        """
        permit = permit or self.supervisor.permit()
        given = {"trajectory": trajectory, "controller": controller, "load": load, "duration": duration}
        chosen = {key: value for key, value in given.items() if value is not None}
        return self._start(self.settings.model_copy(update=chosen), permit)

    def start_experiment(self, name: str, case: str | None = None, *, permit: Permit | None = None) -> RunRequest:
        """Start a case of an experiment on this rig; with `case` None start the first case.

        The robot moves to the start pose first. The present lab or devices are used; deviations from the case are
        shown as warnings and recorded.

        Raises:
            RequestError: the preset or case does not exist, or is for another robot.
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the motion.
        """
        permit = permit or self.supervisor.permit()
        return self.supervisor.start(self.of_experiment(name, case, permit), permit)

    def of_experiment(self, name: str, case: str | None = None, permit: Permit | None = None) -> StartRequest:
        """Return the start request of a case; without `permit` the station's state is not checked.

        Raises:
            RequestError, VoidError, RefusedError: as in `start_experiment`.
        """
        if name not in preset_names("experiments"):
            raise RequestError(f"'{name}' is not one of the experiments: {', '.join(preset_names('experiments'))}")
        if permit is not None:
            self.supervisor.check(Transition.START, permit)  # refuse before the slow check of every case on the model
        experiment = offered_experiment(name)
        chosen = experiment.cases[0] if case is None else next((c for c in experiment.cases if c.name == case), None)
        if chosen is None:
            raise RequestError(
                f"'{case}' is not one of the cases of {name}: {', '.join(c.name for c in experiment.cases)}"
            )
        bench = self.supervisor.bench
        if refused := incompatibility(chosen, bench):
            raise RequestError(f"{name}, case {chosen.name}: {refused}")
        differs = deviations_from_case(chosen, bench)
        controller = bench.controlled(suited(chosen.file.controller, chosen.file.trajectory))
        task = MotionTask(controller, chosen.orders, chosen.file.duration, chosen.start)
        about = {
            "experiment": name,
            "case": chosen.name,
            "settings": {**chosen.file.model_dump(mode="json"), "lab": bench.lab_name},
            "otherwise": list(differs),
            "source": experiment.source,
        }
        return StartRequest(
            task=task,
            title=f"{name.replace('_', ' ')}: {case_words(chosen, experiment.title)}",
            load=chosen.file.load,
            faults=tuple(chosen.file.faults),
            counted_from=chosen.file.counted_from,
            warnings=(*differs, *chosen.warnings),
            about=about,
        )

    def home(self, *, then_work: bool = True, permit: Permit | None = None) -> None:
        """Home every stage, then go to the working pose if there is one; the caller confirms that the path is clear.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state is neither CONNECTED nor READY, or the stages cannot be homed.
        """
        permit = permit or self.supervisor.permit()
        self.supervisor.check(Transition.HOME, permit)
        bench = self.supervisor.bench
        then = goto_working_pose(bench) if then_work and bench.robot.working_pose is not None else None
        self.supervisor.home(then, permit)

    def go_to(self, joints: Mapping[str, float] | None, *, permit: Permit | None = None) -> RunRequest:
        """Move the joints that `joints` names to positions [rad or m], all at the same time; None: to the working pose.

        Other joints keep their position.

        Raises:
            RefusedError: the state does not allow the motion.
            CtrError: a joint is unknown or outside its travel, the pose is invalid, or the tubes would snap on the
                path.
        """
        supervisor = self.supervisor
        permit = permit or supervisor.permit()
        supervisor.check(Transition.START, permit)
        bench, now = supervisor.bench, supervisor.status().values["joints"]
        if joints is None:
            start = goto_working_pose(bench)
        else:
            known = dict(zip(supervisor.robot.joint_names, now.tolist(), strict=True))
            target = named_pose(known | dict(joints), bench.robot, "joints")
            start = goto_joints(bench, target, "to a pose" if len(joints) == len(known) else f"to {', '.join(joints)}")
        check_path(bench, start, now)
        return supervisor.start(start, permit)

    def start_stream(self, agreement: StreamAgreement, *, permit: Permit | None = None) -> RunRequest:
        """Start a motion from the present pose whose setpoints a client streams during the run.

        Raises:
            RefusedError: the state does not allow the motion.
            CtrError: the controller is invalid, or the present pose violates a limit.
        """
        permit = permit or self.supervisor.permit()
        file = agreement.controller or default_controller(self.supervisor.bench.present)
        controller = self.supervisor.bench.controlled(file)
        task = MotionTask(controller, agreement.limits(), agreement.duration)
        values = self.supervisor.status().values
        if "joints" in values:
            check_pose(task.controller.statics, task.controller.limits, values["joints"])
            task.controller.check_loops(values["joints"])
        settings = {
            "controller": file.model_dump(mode="json"),
            "duration": agreement.duration,
            "stream": agreement.model_dump(mode="json", exclude={"controller"}),
        }
        about = {"settings": settings}
        return self.supervisor.start(StartRequest(task, "streamed setpoints", load=None, about=about), permit)

    def send_setpoint(self, run: RunRequest, request: SetpointRequest | None) -> None:
        """Send a setpoint request to a streamed run; None: end the stream, and the tip comes to rest."""
        self.supervisor.ring.write_request(StreamRequest(run.number, request))

    def jog(self, space: Space, velocity: tuple[float, ...], *, permit: Permit | None = None) -> None:
        """Jog for the next 0.3 s: joints [rad/s or m/s], the tip [m/s], or its direction [rad/s].

        Raises:
            RequestError: the number of velocities is wrong, or a velocity exceeds the limit for jogging.
            RefusedError: the state does not allow the motion.
        """
        limits = self.supervisor.bench.robot.limits()
        names = self.supervisor.robot.joint_names if space == "joints" else ("x", "y", "z")
        tip_limit = JOG_TIP_SPEED_M_S if space == "tip" else JOG_TURN_SPEED_RAD_S
        bounds = limits.speed if space == "joints" else np.full(3, tip_limit)
        if len(velocity) != len(names):
            raise RequestError(
                f"a jog in {space} needs {len(names)} velocities ({', '.join(names)}), not {len(velocity)}"
            )
        for name, value, bound in zip(names, velocity, bounds, strict=True):
            if not abs(value) <= bound:
                raise RequestError(f"jog velocity {name} = {value:g} is outside +-{bound:g} (rad/s or m/s)")
        self.supervisor.jog(space, np.array(velocity), permit)

    def apply_load(self, load: Load) -> None:
        """Apply a load to the virtual lab's tip or shaft now.

        Raises:
            PoseError: the load acts beyond the tip.
        """
        self._check(load)
        self.supervisor.apply_load(load)

    def _check(self, load: Load) -> None:
        """Check that a load acts on the robot's shaft and that a custom load returns a force."""
        force_of(load, 0.0)
        values = self.supervisor.status().values
        if math.isfinite(load.contact) and "joints" in values:
            self.supervisor.robot.check_contact(values["joints"], load.contact)

    def _start(self, settings: StationSettings, permit: Permit) -> RunRequest:
        """Start a free motion with these settings, after a check on the model."""
        orders = Orders(settings.trajectory, self.supervisor.robot)
        if orders.follow is not None and (missing := missing_target(self.supervisor.bench)):
            raise RequestError(f"{settings.trajectory.kind}: {missing}")
        controller = self.supervisor.bench.controlled(suited(settings.controller, settings.trajectory))
        if excessive := excessive_force(orders.press, self.supervisor.bench):
            raise RequestError(f"{settings.trajectory.kind}: {excessive}")
        task = MotionTask(controller, orders, settings.duration)
        self._check(settings.load)
        self.supervisor.check(Transition.START, permit)
        joints = self.supervisor.status().values["joints"]
        try:
            orders.check(task.controller, joints, task.duration)
        except Unreachable as error:
            instead = suggest_motion(settings.trajectory, task.controller, joints, task.duration) or WORKING_POSE_HINT
            raise Unreachable(f"{error}; {instead}") from None
        warnings = load_warnings(orders, task.controller, joints, task.duration, settings.load)
        start = StartRequest(
            task=task,
            title=motion_title(settings.trajectory, settings.load),
            load=settings.load,
            counted_from=counted_from(settling_time(task.duration), settings.load.onset),
            warnings=warnings,
            about={"settings": settings.model_dump(mode="json")},
        )
        return self.supervisor.start(start, permit)
