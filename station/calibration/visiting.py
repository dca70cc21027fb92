"""A step of a procedure as a task of the control loop, and rows of telemetry as what was measured in it.

The same in virtual time and on a running station.
"""

import math
from dataclasses import replace

import numpy as np

from core.calibration.measurements import Measurement
from core.control.step import Controller
from core.control.trajectories import JointMotion
from core.model.many import solve_many
from core.robot.robot import Array
from station.calibration.procedure import AbortedError, GoTo, Swing, Swung
from station.control.margins import Margins
from station.control.settle_and_tare import AVERAGE
from station.control.states import State
from station.control.task import Task
from station.control.telemetry import Channels

#: At each rest the loop tares away the weight that hangs, and its model goes on without it; and nothing is calibrated
#: yet. Only a tip that is somewhere else altogether stops a procedure.
MARGINS = Margins(apart=0.12)
#: After a weight was hung or taken off it may swing this long [s].
SWINGING = 2.0
#: So much of the time that is averaged must have been seen.
LEAST_SEEN = 0.5


class Sway:
    """Orders in joints: to and fro from where they are, or nothing at all."""

    def __init__(self, amplitudes: Array, period: float) -> None:
        self._amplitudes, self._rate = amplitudes, 2.0 * math.pi / period

    def at(self, time: float) -> JointMotion:
        """Velocities `time` [s] after the start: a (1 - cos) / 2 begins and ends at rest where it began."""
        return JointMotion(0.5 * self._rate * math.sin(self._rate * time) * self._amplitudes)


def still(joints: int) -> Sway:
    """Orders to stand."""
    return Sway(np.zeros(joints), 1.0)


def task(step: GoTo | Swing, controller: Controller) -> Task:
    """A measurement ends with the rest before its motion, a swing begins there; where the coil points is recorded."""
    controller = replace(controller, watches=True)
    if isinstance(step, GoTo):
        return Task(controller, still(len(step.joints)), 0.0, step.joints, MARGINS)
    return Task(controller, Sway(step.amplitudes, step.period), step.duration, margins=MARGINS)


def measured(
    channels: Channels, rows: Array, step: GoTo | Swing, before: Array, controller: Controller
) -> Measurement | Swung:
    """What the last rest, or a swing, has shown.

    Args:
        channels: of the rows.
        rows: telemetry (m, channels) of the task, or more of it.
        step: what was to be done.
        before: joints (n,) from which the robot came [rad or m].
        controller: of the task.

    Raises:
        AbortedError: too little was seen of it, or nothing by the tracker.
    """
    running = rows[channels.of(rows, "state")[:, 0] == State.RUNNING]
    times = channels.of(running, "time")[:, 0]
    wanted, period = AVERAGE if isinstance(step, GoTo) else step.duration, _period(times)
    counted = running[times > times.max(initial=0.0) - wanted + 0.5 * period]
    if len(counted) < LEAST_SEEN * wanted / period:
        seen = len(counted) * period
        raise AbortedError(f"only {seen:.1f} of {wanted:g} s were recorded: the computer is too busy")
    frames = counted[channels.of(counted, "tip_new")[:, 0] > 0.0]
    if len(frames) == 0:
        raise AbortedError("no tracker frame while the robot rested; is the coil inside the tracker's volume?")
    times, joints = channels.of(counted, "time")[:, 0], channels.of(counted, "joints")
    coils, axes = _coils(channels, frames, controller)
    if isinstance(step, Swing):
        seen = channels.of(frames, "tip_time")[:, 0]
        # The first frames were measured before the swing began.
        inside = (seen > times[0] + 0.1) & (seen < times[-1])
        return Swung(times, joints, seen[inside], coils[inside])
    wrenches = channels.of(counted, "wrench_raw").mean(axis=0).reshape(-1, 6)
    came = np.sign(joints[-1] - before)
    axis = None
    if axes.any():
        mean = axes.mean(axis=0)
        axis = (mean / float(np.linalg.norm(mean)))[None]
    return Measurement(float(times.mean()), joints[-1].copy(), coils.mean(axis=0), wrenches, step.weight, came, axis)


def _coils(channels: Channels, frames: Array, controller: Controller) -> tuple[Array, Array]:
    """Where the coil was (k, 3) [m], and its axis (k, 3), zeros where the tracker does not tell.

    A calibration that is in use has led the controller from there to the tip.
    """
    tips, directions = channels.of(frames, "tip_measured"), channels.of(frames, "direction_measured")
    known = controller.corrections
    if known is None or not (known.coil.any() or known.axis is not None):
        return tips, directions
    forces = channels.of(frames, "force")
    loads = np.column_stack((forces, np.zeros_like(forces)))
    turns = solve_many(controller.statics, channels.of(frames, "joints"), loads).complete().rotation
    axes = [known.coil_axis(direction, turn) for direction, turn in zip(directions, turns, strict=True)]
    return tips + turns @ known.coil, np.array(axes)


def _period(times: Array) -> float:
    """Of the ticks [s]; where some were skipped, of the others."""
    return float(np.median(np.diff(times))) if len(times) > 1 else AVERAGE
