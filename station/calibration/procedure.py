"""A calibration procedure as a generator: it yields steps and receives measurements.

The steps are `GoToPose` (move to a pose and rest), `SwingMotion` (oscillate the joints) and `OperatorPrompt` (a task
for the operator). The procedure receives the `Measurement` of each pose and the `SwingRecord` of each swing. A loop in
virtual time or a station with an operator executes the steps. Closing the generator aborts the procedure.
"""

import math
from collections.abc import Generator
from dataclasses import replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from core.calibration.measurements import Measurement
from core.control.controller_settings import Controller
from core.control.trajectories import JointMotion
from core.errors import CtrError
from core.model.batch import solve_many
from core.robot.robot import Array
from station.control.monitors import Margins
from station.control.states import State
from station.control.task import AVERAGE_S, MotionTask
from station.control.telemetry import Channels

Result = TypeVar("Result")


class GoToPose(NamedTuple):
    """Step that moves the robot to a pose, rests and measures; its answer is a `Measurement`."""

    joints: Array  #: (n,) joint positions of the pose [rad or m]
    weight: float | None  #: known weight at the tip [N]; None if unknown
    done: float  #: share of the procedure that is done before this step, 0 ... 1


class OperatorPrompt(NamedTuple):
    """Step that prompts the operator for a task while the robot rests; its answer, after the task is done, is None."""

    text: str
    weight: float  #: weight at the tip after the task [N]
    done: float


class SwingMotion(NamedTuple):
    """Step that oscillates all joints from their present positions; its answer is a `SwingRecord`."""

    amplitudes: Array  #: (n,) peak-to-peak displacement of each joint, to one side of its start [rad or m]
    period: float  #: period of the oscillation [s]
    duration: float  #: duration of the oscillation [s]
    done: float


class SwingRecord(NamedTuple):
    """Recording of stages and tracker during a swing."""

    times: Array  #: (m,) times of the joint positions [s]
    joints: Array  #: (m, n) joint positions that the stages reported [rad or m]
    frame_times: Array  #: (k,) measurement times of the tracker's frames, computed with the known latency [s]
    coils: Array  #: (k, 3) positions of the coil in the tracker's frame [m]


Step = GoToPose | OperatorPrompt | SwingMotion
Answer = Measurement | SwingRecord | None
Procedure = Generator[Step, Answer, Result]


class AbortedError(CtrError):
    """Error of a procedure that ended without a result."""


class StoppedByHandError(AbortedError):
    """Error of a procedure that the operator ended by Ctrl-C."""


class GuidedProcedure(Generic[Result]):
    """A running procedure with its current step."""

    def __init__(self, procedure: Procedure[Result]) -> None:
        """Start the procedure; raises the errors of its planning."""
        self.step: Step | None = None  #: step to execute now; None at the end
        self.result: Result | None = None  #: result of the procedure at its end; None before
        self._procedure = procedure
        self._advance(None, first=True)

    @property
    def done(self) -> float:
        """Share of the procedure that is done, 0 ... 1."""
        return 1.0 if self.step is None else self.step.done

    def answer(self, answer: Answer) -> None:
        """Pass the answer to the current step; raises the procedure's errors (`Unobservable` and others)."""
        self._advance(answer, first=False)

    def outcome(self) -> Result:
        """Return the result at the end of the procedure; raises AbortedError if there is none."""
        if self.result is None:
            raise AbortedError("the procedure ended without a result")
        return self.result

    def abort(self) -> None:
        """Abort the procedure and discard its measurements."""
        self._procedure.close()
        self.step = None

    def _advance(self, answer: Answer, first: bool) -> None:
        try:
            self.step = next(self._procedure) if first else self._procedure.send(answer)
        except StopIteration as end:
            self.step, self.result = None, end.value


#: Margins against a snap during a procedure. The difference between tracker and model may change by 0.12 m, because
#: nothing is calibrated yet, and because each rest tares the hanging weight, so that the model does not contain it.
VISITING_MARGINS = Margins(apart=0.12, unexplained=0.12)
#: Time for a weight to stop swinging after it was hung or removed [s].
SWING_DECAY_S = 2.0
#: Share of the averaging time that must have been recorded.
MIN_VISIBLE_SHARE = 0.5


class SwayMotion:
    """Orders for all joints: an oscillation from their present positions, or rest."""

    def __init__(self, amplitudes: Array, period: float) -> None:
        self._amplitudes, self._rate = amplitudes, 2.0 * math.pi / period

    def at(self, time: float) -> JointMotion:
        """Return the joint velocities at `time` [s] after the start.

        The displacement from the start positions is amplitude * (1 - cos) / 2, so `amplitudes` are peak-to-peak values.
        The oscillation starts and ends at rest at the start positions.
        """
        return JointMotion(0.5 * self._rate * math.sin(self._rate * time) * self._amplitudes)


def rest_orders(joints: int) -> SwayMotion:
    """Return orders that keep all joints at rest."""
    return SwayMotion(np.zeros(joints), 1.0)


def task(step: GoToPose | SwingMotion, controller: Controller) -> MotionTask:
    """Return the task for a step: a move and a rest for a pose, an oscillation for a swing.

    The task records the direction of the coil.
    """
    controller = replace(controller, watches=True)
    if isinstance(step, GoToPose):
        return MotionTask(controller, rest_orders(len(step.joints)), 0.0, step.joints, VISITING_MARGINS, loaded=True)
    sway = SwayMotion(step.amplitudes, step.period)
    return MotionTask(controller, sway, step.duration, margins=VISITING_MARGINS, loaded=True)


def measurement_of(
    channels: Channels, rows: Array, step: GoToPose | SwingMotion, before: Array, controller: Controller
) -> Measurement | SwingRecord:
    """Return the measurement of the last rest, or the record of a swing.

    Args:
        channels: channels of the rows.
        rows: telemetry (m, channels) that contains the task.
        step: step that the task executed.
        before: joint positions (n,) before the step [rad or m].
        controller: controller of the task.

    Raises:
        AbortedError: too few rows were recorded, or the tracker sent no frame.
    """
    running = rows[channels.of(rows, "state")[:, 0] == State.RUNNING]
    times = channels.of(running, "time")[:, 0]
    required, period = AVERAGE_S if isinstance(step, GoToPose) else step.duration, _period(times)
    counted = running[times > times.max(initial=0.0) - required + 0.5 * period]
    if len(counted) < MIN_VISIBLE_SHARE * required / period:
        available = len(counted) * period
        raise AbortedError(f"only {available:.1f} of {required:g} s were recorded: the computer is too busy")
    frames = counted[channels.of(counted, "tip_new")[:, 0] > 0.0]
    if len(frames) == 0:
        raise AbortedError("no tracker frame while the robot rested; is the coil inside the tracker's volume?")
    times, joints = channels.of(counted, "time")[:, 0], channels.of(counted, "joints")
    coils, axes = _coils(channels, frames, controller)
    if isinstance(step, SwingMotion):
        measured = channels.of(frames, "tip_time")[:, 0]
        # Leave out the first frames, which were measured before the swing started.
        inside = (measured > times[0] + 0.1) & (measured < times[-1])
        return SwingRecord(times, joints, measured[inside], coils[inside])
    wrenches = channels.of(counted, "wrench_raw").mean(axis=0).reshape(-1, 6)
    arrival = np.sign(joints[-1] - before)
    axis = None
    if axes.any():
        mean = axes.mean(axis=0)
        axis = (mean / float(np.linalg.norm(mean)))[None]
    return Measurement(float(times.mean()), joints[-1].copy(), coils.mean(axis=0), wrenches, step.weight, arrival, axis)


def _coils(channels: Channels, frames: Array, controller: Controller) -> tuple[Array, Array]:
    """Return positions (k, 3) [m] and axes (k, 3) of the coil, zeros where the tracker does not report them.

    With a calibration in use the telemetry has the tip; this function converts it back to the coil.
    """
    tips, directions = channels.of(frames, "tip_measured"), channels.of(frames, "direction_measured")
    known = controller.corrections
    if known is None or not (known.coil.any() or known.axis is not None):
        return tips, directions
    forces = channels.of(frames, "force")
    loads = np.column_stack((forces, np.zeros_like(forces)))
    rotations = solve_many(controller.statics, channels.of(frames, "joints"), loads).complete().rotation
    axes = [known.coil_axis(direction, turn) for direction, turn in zip(directions, rotations, strict=True)]
    return tips + rotations @ known.coil, np.array(axes)


def _period(times: Array) -> float:
    """Return the median period of the ticks [s], which skipped ticks do not change."""
    return float(np.median(np.diff(times))) if len(times) > 1 else AVERAGE_S
