"""What an operator or a script may ask of a running station, checked before anything moves."""

import math
import threading
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field

from core.control.leading import Wish
from core.errors import CtrError, Unreachable
from station.config.controllers import BEST, ControllerFile
from station.config.motions import HoldMotion, Orders, TipMotion
from station.config.robots import named_pose
from station.config.strict import Strict, preset_names
from station.control.jog import Space
from station.control.led import Asked
from station.control.states import Event, State, after
from station.control.task import Task
from station.experiments.experiment import load_warnings, offered
from station.lab.loads import Load, NoLoad
from station.recording.tracking_errors import counted_from, settling_time
from station.service.fits import no_target, otherwise, refusal
from station.service.goto import check_way, to_joints, to_working_pose
from station.service.leader import LeadIn
from station.service.start import Run, Start
from station.service.suggestion import MORE_ROOM, suggestion
from station.service.supervisor import Supervisor

#: Of the tip when it is moved by hand [m/s].
JOG_TIP_SPEED = 0.010
#: And fastest that its direction is turned by hand [rad/s].
JOG_TURN_SPEED = 0.1


class RequestError(CtrError):
    """A request that makes no sense, whatever the state."""


class Settings(Strict):
    """What the next free motion will be."""

    trajectory: Annotated[TipMotion, Field(discriminator="kind")] = HoldMotion()
    controller: ControllerFile = BEST
    load: Load = NoLoad()
    """on the simulated tip; a real bench has its own"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)] = 60.0
    """[s]"""


class StationService:
    """Experiments and free motions on one station."""

    def __init__(self, supervisor: Supervisor) -> None:
        self.supervisor = supervisor
        self._settings = Settings()
        self._lock = threading.Lock()

    @property
    def settings(self) -> Settings:
        """What the next free motion will be."""
        with self._lock:
            return self._settings

    def set_trajectory(self, trajectory: TipMotion) -> None:
        """Choose the next free motion."""
        with self._lock:
            self._settings = self._settings.model_copy(update={"trajectory": trajectory})

    def set_controller(self, controller: ControllerFile) -> None:
        """Choose the controller of the next free motion.

        Raises:
            DescriptionError: unknown strategy, gain or bandwidth out of range.
        """
        self.supervisor.bench.controlled(controller)
        with self._lock:
            self._settings = self._settings.model_copy(update={"controller": controller})

    def set_load(self, load: Load) -> None:
        """Choose the load of the next free motion."""
        with self._lock:
            self._settings = self._settings.model_copy(update={"load": load})

    def start_motion(
        self,
        trajectory: TipMotion | None = None,
        controller: ControllerFile | None = None,
        load: Load | None = None,
        duration: float | None = None,
    ) -> Run:
        """Start a free motion from where the robot is; what is not given is as set before.

        Raises:
            RefusedError: the state does not allow it.
            CtrError: the motion or the controller cannot be.
        """
        given = {"trajectory": trajectory, "controller": controller, "load": load, "duration": duration}
        chosen = {key: value for key, value in given.items() if value is not None}
        return self._start(self.settings.model_copy(update=chosen))

    def start_experiment(self, name: str, case: str | None = None) -> Run:
        """Start a case of an experiment (the first when none is named) on this bench.

        The robot goes to the start pose first. The lab is the one that is there; what is otherwise than the case
        has it is told, and recorded.

        Raises:
            RequestError: no such preset or case, or one for another robot.
            RefusedError: the state does not allow it.
        """
        return self.supervisor.start(self.of_experiment(name, case))

    def of_experiment(self, name: str, case: str | None = None) -> Start:
        """The start of a case; raises as `start_experiment` does, whatever the state."""
        if name not in preset_names("experiments"):
            raise RequestError(f"'{name}' is not one of the experiments: {', '.join(preset_names('experiments'))}")
        experiment = offered(name)
        chosen = experiment.cases[0] if case is None else next((c for c in experiment.cases if c.name == case), None)
        if chosen is None:
            raise RequestError(
                f"'{case}' is not one of the cases of {name}: {', '.join(c.name for c in experiment.cases)}"
            )
        bench = self.supervisor.bench
        if refused := refusal(chosen, bench):
            raise RequestError(f"{name}, case {chosen.name}: {refused}")
        differs = otherwise(chosen, bench)
        controller = bench.controlled(chosen.file.controller)
        task = Task(controller, chosen.orders, chosen.file.duration, chosen.start)
        about = {
            "experiment": name,
            "case": chosen.name,
            "settings": {**chosen.file.model_dump(mode="json"), "lab": bench.lab_name},
            "otherwise": list(differs),
            "source": experiment.source,
        }
        return Start(
            task=task,
            title=f"{name}, case {chosen.name}",
            load=chosen.file.load,
            faults=tuple(chosen.file.faults),
            counted_from=chosen.file.counted_from,
            warnings=(*differs, *chosen.warnings),
            about=about,
        )

    def home(self, *, then_work: bool = True) -> None:
        """Home every stage, then go to the working pose, if the robot has one; a person has said the way is clear.

        Raises:
            RefusedError: neither CONNECTED nor READY, or the stages cannot.
        """
        bench = self.supervisor.bench
        self.supervisor.home(to_working_pose(bench) if then_work and bench.robot.working_pose is not None else None)

    def go_to(self, joints: Mapping[str, float] | None) -> Run:
        """Go to `joints` [rad or m], all at the same time; those not named stay. None: to the working pose.

        Raises:
            RefusedError: the state does not allow it.
            CtrError: a joint is unknown or outside its travel, the tubes cannot stand there or would snap on the way.
        """
        supervisor = self.supervisor
        bench, status = supervisor.bench, supervisor.status()
        after(status.state, Event.START)
        now = status.values["joints"]
        if joints is None:
            start = to_working_pose(bench)
        else:
            known = dict(zip(supervisor.robot.joint_names, now.tolist(), strict=True))
            target = named_pose(known | dict(joints), bench.robot, "joints")
            start = to_joints(bench, target, "to a pose" if len(joints) == len(known) else f"to {', '.join(joints)}")
        check_way(bench, start, now)
        return supervisor.start(start)

    def start_led(self, asked: LeadIn) -> Run:
        """Start a motion from where the robot is that is led by what is asked for while it goes on.

        Raises:
            RefusedError: the state does not allow it.
            CtrError: the controller cannot be.
        """
        task = Task(self.supervisor.bench.controlled(asked.controller), asked.lead(), asked.duration)
        about = {"settings": {"controller": asked.controller.model_dump(mode="json"), "duration": asked.duration,
                              "led": asked.model_dump(mode="json", exclude={"controller"})}}  # fmt: skip
        return self.supervisor.start(Start(task=task, title="led from outside", load=None, about=about))

    def lead(self, run: Run, wish: Wish | None) -> None:
        """Ask something of the tip of a run that is led; None: that was all, the tip is to come to rest."""
        self.supervisor.ring.ask(Asked(run.number, wish))

    def jog(self, space: Space, velocity: tuple[float, ...]) -> None:
        """Move by hand for the next 0.3 s: joints [rad/s or m/s], the tip [m/s], or its direction [rad/s].

        Raises:
            RequestError: a wrong number of velocities, or one beyond what is allowed by hand.
            RefusedError: the state does not allow it.
        """
        limits = self.supervisor.bench.robot.limits()
        names = self.supervisor.robot.joint_names if space == "joints" else ("x", "y", "z")
        by_hand = JOG_TIP_SPEED if space == "tip" else JOG_TURN_SPEED
        most = limits.speed if space == "joints" else np.full(3, by_hand)
        if len(velocity) != len(names):
            raise RequestError(
                f"a jog in {space} needs {len(names)} velocities ({', '.join(names)}), not {len(velocity)}"
            )
        for name, value, bound in zip(names, velocity, most, strict=True):
            if not abs(value) <= bound:
                raise RequestError(f"jog velocity {name} = {value:g} is outside +-{bound:g} (rad/s or m/s)")
        self.supervisor.jog(space, np.array(velocity))

    def apply_load(self, load: Load) -> None:
        """Put a load on the virtual lab's tip or shaft, now.

        Raises:
            PoseError: the shaft does not reach to where it acts.
        """
        self._check(load)
        self.supervisor.apply_load(load)

    def _check(self, load: Load) -> None:
        """The simulated robot cannot be touched beyond its tip."""
        values = self.supervisor.status().values
        if math.isfinite(load.contact) and "joints" in values:
            self.supervisor.robot.check_contact(values["joints"], load.contact)

    def _start(self, settings: Settings) -> Run:
        """Start a free motion."""
        orders = Orders(settings.trajectory, self.supervisor.robot)
        if orders.follow is not None and (missing := no_target(self.supervisor.bench)):
            raise RequestError(f"{settings.trajectory.kind}: {missing}")
        task = Task(self.supervisor.bench.controlled(settings.controller), orders, settings.duration)
        self._check(settings.load)
        status, warnings = self.supervisor.status(), ()
        if status.state is State.READY and "joints" in status.values:
            joints = status.values["joints"]
            try:
                orders.check(task.controller, joints, task.duration)
            except Unreachable as error:
                instead = suggestion(settings.trajectory, task.controller, joints, task.duration) or MORE_ROOM
                raise Unreachable(f"{error}; {instead}") from None
            warnings = load_warnings(orders, task.controller, joints, task.duration, settings.load)
        start = Start(
            task=task,
            title=f"{settings.trajectory.kind}, free motion",
            load=settings.load,
            counted_from=counted_from(settling_time(task.duration), settings.load.onset),
            warnings=warnings,
            about={"settings": settings.model_dump(mode="json")},
        )
        return self.supervisor.start(start)
