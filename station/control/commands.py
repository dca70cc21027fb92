"""Commands of operators and scripts, one class each: schema and description of the request, and its effect on the loop.

`station.service.commands` has the commands that the station process executes or plans, and a list of all commands. The
control process decides whether its state allows a command, because only it knows the state of this tick.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field, SkipValidation

from core.errors import CtrError
from station.config.controllers import Stiffness
from station.config.robots import RobotFile
from station.config.strict import Strict
from station.control.loop import ControlLoop
from station.control.states import RefusedError, State, Transition, origins
from station.control.task import MotionTask, Space

#: Largest speed of the tip while jogging [m/s].
JOG_TIP_SPEED_M_S = 0.010
#: Largest turning rate of the tip's direction while jogging [rad/s].
JOG_TURN_SPEED_RAD_S = 0.1


class RequestError(CtrError):
    """A request is invalid in every state of the station."""


class Command(Strict):
    """Command that a client can send; its fields are those of the request, and its docstring describes it to users."""

    name: ClassVar[str]  #: name in refusals and in the path of the request
    states: ClassVar[tuple[State, ...]]  #: states in which the command is accepted
    moves: ClassVar[bool] = False  #: whether the robot moves, so that a STOP or a reset voids an earlier request
    method: ClassVar[Literal["POST", "PUT", "DELETE"]] = "POST"  #: HTTP method of the request
    starts_run: ClassVar[bool] = False  #: whether the answer to the request is the id of a run
    needs_lab: ClassVar[bool] = False  #: whether only a virtual lab accepts the command
    may_be_empty: ClassVar[bool] = False  #: whether the request may have no body, although the command has fields

    @classmethod
    def path(cls) -> str:
        """Return the path of the request."""
        return f"/api/{cls.name}"

    def check(self, robot: RobotFile) -> None:
        """Check the values for this robot in the station process.

        Raises:
            RequestError: a value is invalid; the text has its bound and unit.
        """


class LoopCommand(Command):
    """Command that the station process sends to the control process as it is."""

    @abstractmethod
    def apply(self, loop: ControlLoop, now: float) -> None:
        """Execute the command in the control process at `now` [s]; raise CtrError to refuse it."""


class Connect(LoopCommand):
    """Search for the devices and connect them."""

    name = "connect"
    states = origins(Transition.CONNECT)

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Connect every device."""
        loop.connect(now)


class Tare(LoopCommand):
    """Zero the force sensors with the mean of their next readings.

    A tare is refused while the tip has contact, because it would hide the contact.
    """

    model_config = ConfigDict(json_schema_extra={"examples": [{"untouched": False}]})
    name = "tare"
    states = (State.READY,)
    may_be_empty = True

    untouched: bool = False
    """true: the operator has checked that nothing touches the robot, and the tare may remove any force"""

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Start the tare."""
        loop.tare(now, untouched=self.untouched)


class Jog(LoopCommand):
    """Jog for 0.3 s; repeat the request to continue."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"space": "tip", "velocity": [0.0, 0.0, 0.002]}]})
    name = "jog"
    states = (*origins(Transition.START), State.RUNNING)  # RUNNING: only while another jog is active
    moves = True

    space: Space
    """what moves: all joints, the tip, or the direction of the tip at constant position"""
    velocity: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=20)]
    """velocity of every joint [rad/s or m/s]; or, in the world frame, of the tip [m/s] or of its direction [rad/s]"""

    def check(self, robot: RobotFile) -> None:
        """Check the number of velocities and their bounds."""
        names = tuple(joint.name for joint in robot.joints) if self.space == "joints" else ("x", "y", "z")
        units = ["m/s" if self.space == "tip" else "rad/s"] * 3
        if self.space == "joints":
            units = ["rad/s" if joint.motion == "rotation" else "m/s" for joint in robot.joints]
        if len(self.velocity) != len(names):
            raise RequestError(
                f"a jog in {self.space} needs {len(names)} velocities ({', '.join(names)}), not {len(self.velocity)}"
            )
        tip_bound = JOG_TIP_SPEED_M_S if self.space == "tip" else JOG_TURN_SPEED_RAD_S
        bounds = robot.limits().speed if self.space == "joints" else np.full(3, tip_bound)
        for name, unit, value, bound in zip(names, units, self.velocity, bounds, strict=True):
            if not abs(value) <= bound:
                raise RequestError(f"jog velocity {name} = {value:g} {unit} is outside +-{bound:g} {unit}")

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Start or renew the jog."""
        loop.jog(now, self.space, np.array(self.velocity))


class SetStiffness(LoopCommand):
    """Change the stiffness of the tip for the rest of the present motion, which reaches it within 1 s."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"stiffness": [30.0, 30.0, 300.0]}]})
    name = "stiffness"
    states = (State.RUNNING,)
    moves = True
    method = "PUT"

    stiffness: Stiffness
    """stiffness of the tip along the axes x, y, z of the motion's `stiffness_frame` [N/m]"""

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Start the change of the stiffness."""
        loop.set_stiffness(now, self.stiffness)


class Stop(LoopCommand):
    """Stop every axis; always accepted, from any client with access."""

    name = "stop"
    states = tuple(State)

    cause: SkipValidation[str] = "stopped by the operator"  # no text may prevent a STOP

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Stop every axis."""
        loop.stop(now, cause=self.cause)


class Reset(LoopCommand):
    """Leave HOLD, STOPPED or FAULT after a person has checked the cause; ended processes are restarted."""

    name = "reset"
    states = origins(Transition.RESET)

    who: SkipValidation[str] = "the operator"
    of_fault: bool = True
    """false: a FAULT is not reset, because no person has seen its cause"""

    def check_fault(self, state: State) -> None:
        """Raise RefusedError if the command may not reset a FAULT and `state` is this state."""
        if state is State.FAULT and not self.of_fault:
            raise RefusedError("a person must check the cause of the FAULT and reset it, on the page or over REST")

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Leave the latched state."""
        self.check_fault(loop.state)
        loop.reset(now)


@dataclass(frozen=True)
class Hold:
    """End of a motion in HOLD, which the station process requests after the loss of the operator or the recorder."""

    cause: str
    name = "hold"
    states = tuple(State)  # the stages are stopped in every state, also if the state then refuses HOLD

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Stop every axis and keep the position."""
        loop.stop(now, Transition.HOLD, self.cause)


@dataclass(frozen=True)
class Execute:
    """Execution of a planned motion; `task.run` is the number of its run."""

    task: MotionTask
    name = "start"
    states = origins(Transition.START)

    def apply(self, loop: ControlLoop, now: float) -> None:  # noqa: ARG002 - the next tick starts the task
        """Start the task."""
        loop.start(self.task)


@dataclass(frozen=True)
class StreamPose:
    """Motion of the joints toward a checked pose (n,) [rad or m] for 0.3 s."""

    joints: tuple[float, ...]
    name = "servo"
    states = Jog.states

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Start or renew the motion."""
        loop.jog(now, "pose", np.array(self.joints))


@dataclass(frozen=True)
class HomeStages:
    """Homing of every stage, and then the execution of `then`; a person has confirmed that the path is clear."""

    then: MotionTask | None = None
    name = "home"
    states = origins(Transition.HOME)

    def apply(self, loop: ControlLoop, now: float) -> None:
        """Start homing."""
        loop.home(now, self.then)


#: Commands that the station process sends to the control process; each has a name, states and `apply`.
ControlCommand = LoopCommand | Hold | Execute | StreamPose | HomeStages


class CommandMessage(NamedTuple):
    """Command from the station process to the control process."""

    number: int  #: number of the command, repeated in its reply
    command: ControlCommand
    until: float = math.inf  #: deadline after which the command is rejected, by the station's clock [s]
    #: number of STOPs and resets before the request; a later one voids the command; None: never void
    generation: int | None = None


class Reply(NamedTuple):
    """Answer of the control process to a command of the station process."""

    number: int  #: number of the command
    refused: str  #: reason of the refusal; empty when the command was executed
