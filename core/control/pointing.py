"""Where the tip points: what is asked of its direction, and what is known of it.

A task is rows of one equation for the joints. The place gives three; the direction two, the turning of the tip about
the two axes across it, for a turn about the tip's own axis does not change where it points. Both sides of the
direction's rows come from the same inner loop as the place's, from the lower rows of J and C, and count with a lever:
a radian is worth so many metres.

The direction is observed as the place is: as an arrow that the tip carries, so long that the tracker's noise at its
head is that of a place.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.controllers import inner_law
from core.control.estimation import Estimate, Estimator, known_of
from core.control.inverse import SIGMA_FLOOR
from core.control.observer import observe
from core.errors import DescriptionError
from core.model.solution import parts
from core.robot.robot import Array

#: Length of the arrow [m]: an Aurora's coil tells its place to 0.1 mm and its axis to 5 mrad.
REACH = 0.02
#: Weight of a radian [m/rad], unless said otherwise.
LEVER = 0.05

#: `SIGMA_FLOOR` where a direction counts: a coil's axis is noisier than its place, and what is hardly within the
#: joints' reach they would chase at full speed, to and fro [m/s].
DIRECTED_FLOOR = 2e-3

#: Tasks by name: whether the place counts, and the direction.
TASKS = {"position": (True, False), "position_and_direction": (True, True), "direction": (False, True)}


@dataclass(frozen=True)
class Aim:
    """Weights of what of the tip is controlled; 0 leaves it free."""

    place: float = 1.0  #: [1]
    lever: float = 0.0  #: of the direction [m/rad]

    @property
    def rows(self) -> int:
        """Equations for the joints."""
        return 3 * (self.place > 0.0) + 2 * (self.lever > 0.0)

    @property
    def floor(self) -> float:
        """Tip speed in the worst direction below which the inverse is damped [m/s]."""
        return DIRECTED_FLOOR if self.lever > 0.0 else SIGMA_FLOOR


#: Where the tip is, wherever it points.
PLACE = Aim()


def aim(task: str, lever: float = LEVER) -> Aim:
    """The aim of that name.

    Raises:
        DescriptionError: there is no such task.

    """
    if task not in TASKS:
        raise DescriptionError(f"task '{task}' is unknown; choose one of {', '.join(TASKS)}")
    place, direction = TASKS[task]
    return Aim(float(place), lever if direction else 0.0)


class Pointed(NamedTuple):
    """What is known of the tip's direction at one tick. World frame."""

    measured: Array  #: (3,) latest of the tracker's, or as observed while it tells none
    origin: Array  #: (3,) at the start of the motion: what "keep it" means
    numbers: Array  #: (m,) `observed`, and what the next tick needs: see `_Numbers`
    seen: bool = False  #: the tracker has told it

    @property
    def observed(self) -> Array:
        """(3,) the best estimate of the direction now."""
        return self.numbers[:3]

    @property
    def ahead(self) -> Array:
        """(3,) the same when a command of now takes effect."""
        return self.numbers[3:6]

    @property
    def turnings(self) -> Array:
        """(3, 3) by the load C w', that and (J(q, w) - J(q, 0)) q', and by what the model does not know of [rad/s]."""
        return self.numbers[6:15].reshape(3, 3)


class _Numbers(NamedTuple):
    """Views of the numbers of `Pointed`."""

    now: Array  #: (5, 3) `observed`, `ahead` and `turnings`
    bias: Array  #: (3,) of the arrow's head, tracker minus model [m]
    drift: Array  #: (3,) its rate [m/s]
    covariance: Array  #: (3,) as of the observer
    refused: Array  #: (3,) by how much the latest frame that was left out surprised [m]
    counts: Array  #: (2,) place of the newest arrow; so many frames in a row were left out
    arrows: Array  #: (history, 3) the model's of the last ticks [m]


@compiled
def _numbers_of(numbers: Array) -> _Numbers:
    return _Numbers(
        numbers[:15].reshape(5, 3), numbers[15:18], numbers[18:21], numbers[21:24], numbers[24:27], numbers[27:29],
        numbers[29:].reshape((numbers.shape[0] - 29) // 3, 3),
    )  # fmt: skip


def start(estimator: Estimator, model: Array, direction: Array, origin: Array | None = None) -> Pointed:
    """At rest, pointing along `direction` (3,) while the model says `model` (3,)."""
    seen = estimator.observer.start(REACH * model, REACH * direction)
    counts = np.array((seen.place, seen.in_a_row), dtype=np.float64)
    direction = direction.copy()
    return Pointed(direction, direction if origin is None else origin, np.concatenate(
        (direction, direction, np.zeros(9), seen.bias, seen.drift, seen.covariance, seen.refused, counts,
         seen.tips.ravel()),
    ))  # fmt: skip


def look(
    estimator: Estimator, last: Pointed, estimate: Estimate, force: Array, frame: Array | None, age: float
) -> Pointed:
    """One tick on.

    Args:
        estimator: the filters.
        last: of the tick before.
        estimate: of this tick.
        force: (3,) that its loaded model was solved for [N].
        frame, age: the tip's direction (3,) in a tracker frame that has just arrived, and that frame's age [s].

    """
    numbers, told = last.numbers.copy(), (last.origin, -1.0) if frame is None else (frame, age)
    _look(
        estimator.settings, estimate.loaded.numbers, estimate.unloaded.numbers, estimate.numbers, force, *told, numbers
    )
    return Pointed(last.measured if frame is None else frame, last.origin, numbers, last.seen or frame is not None)


@compiled
def _look(
    settings: Array, loaded: Array, unloaded: Array, estimate: Array, force: Array, frame: Array, age: float,
    numbers: Array,
) -> None:  # fmt: skip
    """`look`, with the last tick's numbers, into themselves."""
    now, bias, drift, covariance, refused, counts, arrows = _numbers_of(numbers)
    period, _, _, _, lead, noise, wander, gate = settings
    with_load, free, known = parts(loaded), parts(unloaded), known_of(estimate)
    velocity, n = known.sent[-1], with_load.joints.shape[0]
    axis, smooth, way = np.empty(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        axis[i] = with_load.rotation[i, 2]
        by_load, extra = 0.0, 0.0
        for j in range(3):
            by_load += with_load.compliance[3 + i, j] * known.force_rate[j]
            smooth[i] += with_load.compliance[3 + i, j] * (known.force_smooth[j] - force[j])
        for j in range(n):
            extra += (with_load.jacobian[3 + i, j] - free.jacobian[3 + i, j]) * velocity[j]
            way[i] += with_load.jacobian[3 + i, j] * known.ahead[j]
        way[i] += lead * by_load
        now[2, i], now[3, i] = by_load, by_load + extra
    model = REACH * (axis + _cross(smooth, axis))
    place, _, in_a_row = observe(
        bias, drift, covariance, arrows, refused, int(counts[0]), int(counts[1]),
        model, REACH * frame, age, period, noise, wander, gate,
    )  # fmt: skip
    seen = _unit(model + bias)
    copy(seen, now[0])
    copy(_unit(model + bias + lead * drift + REACH * _cross(way, axis)), now[1])
    copy(_cross(seen, drift) / REACH, now[4])
    counts[0], counts[1] = place, in_a_row


#: Of what is told of a direction that nobody asks for.
NOT_ASKED = np.zeros((6, 3))


def told(pointed: Pointed, wanted: Array | None, turning: Array, observes: bool) -> Array:
    """(6, 3) what `with_direction` is told.

    Args:
        pointed: of this tick.
        wanted: (3,) direction; None keeps that of the start.
        turning: (3,) its angular velocity [rad/s].
        observes: the outer loop looks at the direction of the moment when its command takes effect, not at the frame.

    """
    numbers = np.empty((6, 3))
    numbers[0], numbers[1] = pointed.origin if wanted is None else wanted, turning
    numbers[2] = pointed.ahead if observes else pointed.measured
    numbers[3:] = pointed.turnings
    return numbers


@compiled
def with_direction(
    place: float, lever: float, number: int, gain: float, feedforward: float, lead: float,
    jacobian: Array, velocity: Array, loaded: Array, unloaded: Array, rotation: Array, asked: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """The place's rows, weighted, and under them the direction's; `asked` is what `told` says."""
    if lever == 0.0:
        return jacobian, velocity
    wanted, turning, here = asked[0], asked[1], asked[2]
    aimed = _unit(wanted + lead * _cross(turning, wanted))
    turn = _turn(here, aimed)
    for i in range(3):
        turn[i] = gain * turn[i] + feedforward * turning[i]
    across, right = inner_law(number, turn, loaded[3:], unloaded[3:], asked[4], asked[3], asked[5])
    n, first = jacobian.shape[1], 3 if place > 0.0 else 0
    rows, sides = np.zeros((first + 2, n)), np.zeros(first + 2)
    for i in range(first):
        sides[i] = place * velocity[i]
        for j in range(n):
            rows[i, j] = place * jacobian[i, j]
    for k in range(2):
        for i in range(3):
            part = lever * rotation[i, k]
            sides[first + k] += part * right[i]
            for j in range(n):
                rows[first + k, j] += part * across[i, j]
    return rows, sides


@compiled
def _turn(here: Array, there: Array) -> Array:
    """The shortest turn (3,) from one direction to the other, axis times angle [rad]."""
    axis = _cross(here, there)
    sin, cos = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2), 0.0
    for i in range(3):
        cos += here[i] * there[i]
    angle = np.arctan2(sin, cos)
    return axis * (angle / sin) if sin > 1e-12 else np.zeros(3)


def turn(here: Array, there: Array) -> Array:
    """The shortest turn (3,) from one direction (3,) to the other, axis times angle [rad]."""
    return _turn(here, there)


def rows_of(aim: Aim, jacobian: Array, rotation: Array) -> Array:
    """What the aim makes of the rows (6, n) of J or C, the tip's frame being `rotation` (3, 3)."""
    parts = [aim.place * jacobian[:3]] * (aim.place > 0.0) + [aim.lever * rotation.T[:2] @ jacobian[3:]] * (
        aim.lever > 0.0
    )
    return np.concatenate(parts)


@compiled
def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def _unit(vector: Array) -> Array:
    return vector / np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
