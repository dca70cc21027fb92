"""Direction of the tip: its control task and its estimate.

A control task consists of rows, and each row is one equation for the joint velocities. The tip's position has three
rows. The tip's direction has two rows: the rotations about the two axes perpendicular to the tip, because a rotation
about the tip's axis does not change the direction. The direction's rows use the same inner loop as the position's rows,
with the lower rows of the Jacobian J and the compliance C. A lever [m/rad] weights the direction's rows and thereby
converts radians to metres.

The observer treats the direction like a position: as the head of an arrow that is fixed to the tip. With the arrow's
length, the tracker's direction noise moves the head as much as its position noise moves a position.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import Shapes, compiled, copy, part
from core.control.controllers import TaskInputs, inner_law
from core.control.estimation import Estimate, Estimator, estimate_fields
from core.control.observer import observe
from core.control.velocity_ik import SIGMA_FLOOR_M_S, VelocityTask
from core.errors import DescriptionError
from core.model.solution import fields
from core.robot.robot import Array

#: Length of the arrow whose head represents the tip's direction [m]: an Aurora coil measures its position to 0.1 mm and
#: its axis to 5 mrad, which is 0.1 mm at this length.
ARROW_LENGTH_M = 0.02
#: Default lever: weight of an error of the tip's direction compared with an error of its position [m/rad].
DEFAULT_LEVER_M = 0.05

#: Smallest singular value without damping for tasks with a direction [m/s]; it replaces `SIGMA_FLOOR_M_S`. A coil's
#: axis is noisier than its position. With less damping the joints would oscillate at full speed to reach directions
#: that are almost out of reach.
DIRECTION_SIGMA_FLOOR_M_S = 2e-3

#: Control tasks by name: whether the task controls the tip's position, and whether it controls its direction.
TASKS = {"position": (True, False), "position_and_direction": (True, True), "direction": (False, True)}


@dataclass(frozen=True)
class TaskSelection:
    """Weights of position and direction in the control task of the tip; a weight of 0 leaves a coordinate free."""

    position: float = 1.0  #: weight of the position, no unit
    lever: float = 0.0  #: weight of the direction [m/rad]

    @property
    def rows(self) -> int:
        """Number of equations that the task gives for the joint velocities."""
        return 3 * (self.position > 0.0) + 2 * (self.lever > 0.0)

    @property
    def floor(self) -> float:
        """Smallest singular value of the task's Jacobian (a tip speed) below which its inverse is damped [m/s]."""
        return DIRECTION_SIGMA_FLOOR_M_S if self.lever > 0.0 else SIGMA_FLOOR_M_S


#: Control task of the tip's position alone; the direction is free.
POSITION_ONLY = TaskSelection()


def task_selection(task: str, lever: float = DEFAULT_LEVER_M) -> TaskSelection:
    """Return the weights of the control task with this name.

    Raises:
        DescriptionError: no task has this name.

    """
    if task not in TASKS:
        raise DescriptionError(f"task '{task}' is unknown; choose one of {', '.join(TASKS)}")
    weight, direction = TASKS[task]
    return TaskSelection(float(weight), lever if direction else 0.0)


class DirectionEstimate(NamedTuple):
    """Estimate of the tip's direction in one tick, world frame."""

    measured: Array  #: (3,) latest direction from the tracker; the observed direction before the first measurement
    origin: Array  #: (3,) direction at the start of the motion, which a setpoint without direction keeps
    numbers: Array  #: (m,) packed direction and filter state, see `_DirectionFields`
    measured_once: bool = False  #: whether the tracker has measured the direction at least once

    @property
    def observed(self) -> Array:
        """(3,) best estimate of the tip's direction in this tick."""
        return self.numbers[:3]

    @property
    def ahead(self) -> Array:
        """(3,) predicted direction of the tip at the time when a command sent now takes effect."""
        return self.numbers[3:6]


class _DirectionFields(NamedTuple):
    """Named views of the packed array of a `DirectionEstimate`."""

    now: Array  #: (5, 3) rows of `observed` and `ahead`, then angular velocities of the tip [rad/s]: of the rotation
    # C w' by the load, of the deflection C w' + (J(q, w) - J(q, 0)) q', and of the drift beyond the model
    bias: Array  #: (3,) bias of the arrow's head, tracker minus model [m]
    drift: Array  #: (3,) rate of this bias [m/s]
    covariance: Array  #: (3,) covariance elements of bias and drift, as in `observer.ObserverState`
    refused: Array  #: (3,) measured head minus the model's head in the latest rejected tracker frame [m]
    counts: Array  #: (3,) index of the newest arrow; number of frames rejected in a row; ticks since a frame was used
    arrows: Array  #: (history, 3) heads of the model's arrow in the last ticks [m]


@compiled
def _shapes(size: int) -> Shapes:
    """Return the shapes of the `_DirectionFields` in an array of `size` values; `arrows` takes the remainder."""
    return (5, 3), (1, 3), (1, 3), (1, 3), (1, 3), (1, 3), ((size - 30) // 3, 3)


@compiled
def _direction_fields(numbers: Array) -> _DirectionFields:
    shapes = _shapes(numbers.shape[0])
    return _DirectionFields(
        part(numbers, shapes, 0), part(numbers, shapes, 1)[0], part(numbers, shapes, 2)[0],
        part(numbers, shapes, 3)[0], part(numbers, shapes, 4)[0], part(numbers, shapes, 5)[0], part(numbers, shapes, 6),
    )  # fmt: skip


@compiled
def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def _unit(vector: Array) -> Array:
    return vector / np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


@compiled
def shortest_rotation_law(here: Array, there: Array) -> Array:
    """Return the shortest rotation (3,) from one direction to the other, axis times angle [rad]."""
    axis = _cross(here, there)
    sin, cos = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2), 0.0
    for i in range(3):
        cos += here[i] * there[i]
    angle = np.arctan2(sin, cos)
    return axis * (angle / sin) if sin > 1e-12 else np.zeros(3)


def start_direction(estimator: Estimator, model: Array, direction: Array) -> DirectionEstimate:
    """Return the estimate of a tip at rest with `direction` (3,); `model` (3,) is the model's tip direction."""
    first = estimator.observer.start(ARROW_LENGTH_M * model, ARROW_LENGTH_M * direction)
    counts = np.array((first.newest, first.in_a_row, first.unused), dtype=np.float64)
    direction = direction.copy()
    return DirectionEstimate(direction, direction, np.concatenate(
        (direction, direction, np.zeros(9), first.bias, first.drift, first.covariance, first.refused, counts,
         first.tips.ravel()),
    ))  # fmt: skip


def update_direction(
    estimator: Estimator, last: DirectionEstimate, estimate: Estimate, force: Array, frame: Array | None, age: float
) -> DirectionEstimate:
    """Return the estimate of the tip's direction one tick later.

    Args:
        estimator: filters of the controller.
        last: direction estimate of the previous tick.
        estimate: estimate of this tick.
        force: force (3,) for which this tick's loaded model was solved [N].
        frame, age: direction of the tip (3,) in a new tracker frame, and that frame's age [s].

    """
    numbers, measurement = last.numbers.copy(), (last.origin, -1.0) if frame is None else (frame, age)
    _update_direction(
        estimator.settings,
        estimate.loaded.numbers,
        estimate.unloaded.numbers,
        estimate.numbers,
        force,
        *measurement,
        numbers,
    )
    return DirectionEstimate(
        last.measured if frame is None else frame, last.origin, numbers, last.measured_once or frame is not None
    )


@compiled
def _update_direction(
    settings: Array, loaded: Array, unloaded: Array, estimate: Array, force: Array, frame: Array, age: float,
    numbers: Array,
) -> None:  # fmt: skip
    """Compute `update_direction` in place: `numbers` contains the values of the last tick before the call."""
    now, bias, drift, covariance, refused, counts, arrows = _direction_fields(numbers)
    period, _, _, _, lead_time, noise, wander, gate = settings
    with_load, free, known = fields(loaded), fields(unloaded), estimate_fields(estimate)
    velocity, n = known.sent[-1], with_load.joints.shape[0]
    axis, smooth, travel = np.empty(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        axis[i] = with_load.rotation[i, 2]
        by_load, extra = 0.0, 0.0
        for j in range(3):
            by_load += with_load.compliance[3 + i, j] * known.force_rate[j]
            smooth[i] += with_load.compliance[3 + i, j] * (known.force_smooth[j] - force[j])
        for j in range(n):
            extra += (with_load.jacobian[3 + i, j] - free.jacobian[3 + i, j]) * velocity[j]
            travel[i] += with_load.jacobian[3 + i, j] * known.ahead[j]
        travel[i] += lead_time * by_load
        now[2, i], now[3, i] = by_load, by_load + extra
    model = ARROW_LENGTH_M * (axis + _cross(smooth, axis))
    newest, _, in_a_row, unused = observe(
        bias, drift, covariance, arrows, refused, int(counts[0]), int(counts[1]), int(counts[2]),
        model, ARROW_LENGTH_M * frame, age, period, noise, wander, gate,
    )  # fmt: skip
    observed = _unit(model + bias)
    copy(observed, now[0])
    copy(_unit(model + bias + lead_time * drift + ARROW_LENGTH_M * _cross(travel, axis)), now[1])
    copy(_cross(observed, drift) / ARROW_LENGTH_M, now[4])
    counts[0], counts[1], counts[2] = newest, in_a_row, unused


class DirectionTask(NamedTuple):
    """Task that turns the tip to a desired direction; its rows are two rotations across the tip's axis."""

    lever: float  #: weight of the rows [m/rad]
    estimate: DirectionEstimate  #: direction estimate of this tick
    desired: Array | None  #: (3,) desired direction; None: the direction at the start of the motion
    turning: Array  #: (3,) angular velocity of the desired direction [rad/s]

    def rows(self, at: TaskInputs) -> VelocityTask:
        """Return the weighted rows (2, n) and their right sides (2,), with the inner loop of the position."""
        gain, _, feedforward, number = at.laws
        estimate, vectors = self.estimate, np.empty((3, 3))
        vectors[0], vectors[1] = estimate.origin if self.desired is None else self.desired, self.turning
        vectors[2] = estimate.ahead if at.feedback.observes else estimate.measured
        return VelocityTask(
            *_direction_rows(
                self.lever, number, gain, feedforward, at.feedback.lead_time,
                at.loaded.numbers, at.unloaded.numbers, vectors, estimate.numbers,
            )
        )  # fmt: skip


@compiled
def _direction_rows(
    lever: float, number: int, gain: float, feedforward: float, lead_time: float,
    loaded: Array, unloaded: Array, vectors: Array, numbers: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Compute `DirectionTask.rows`; rows of `vectors`: desired direction, its angular velocity, present direction."""
    desired, turning, here = vectors[0], vectors[1], vectors[2]
    with_load, free, now = fields(loaded), fields(unloaded), _direction_fields(numbers).now
    aimed = _unit(desired + lead_time * _cross(turning, desired))
    turn = shortest_rotation_law(here, aimed)
    for i in range(3):
        turn[i] = gain * turn[i] + feedforward * turning[i]
    across, right = inner_law(number, turn, with_load.jacobian[3:], free.jacobian[3:], now[3], now[2], now[4])
    n = across.shape[1]
    rows, sides = np.zeros((2, n)), np.zeros(2)
    for k in range(2):
        for i in range(3):
            weight = lever * with_load.rotation[i, k]
            sides[k] += weight * right[i]
            for j in range(n):
                rows[k, j] += weight * across[i, j]
    return rows, sides


def shortest_rotation(here: Array, there: Array) -> Array:
    """Return the shortest rotation (3,) from one direction (3,) to the other, axis times angle [rad]."""
    return shortest_rotation_law(here, there)


def task_rows(aim: TaskSelection, jacobian: Array, rotation: Array) -> Array:
    """Return the control task's rows from the six rows of J or C, (6, n); `rotation` (3, 3) is the tip's frame."""
    parts = [aim.position * jacobian[:3]] * (aim.position > 0.0) + [aim.lever * rotation.T[:2] @ jacobian[3:]] * (
        aim.lever > 0.0
    )
    return np.concatenate(parts)
