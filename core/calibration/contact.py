"""Location of a load on the shaft, from the total force and moment of the base sensors.

A force F at the point r(s) of the shaft causes the moment M = r(s) x F in the sum of the base sensors; s is the arc
length. The search evaluates the mismatch c between measured and expected moment along the shaft. For each s, the model
computes r(s) with the force F at s:

    c(s) = M - r(s) x F,    chi2(s) = c^T S^-1 c,    S = S_M + [r x] S_F [r x]^T + [F x] S_r [F x]^T

where S_M, S_F and S_r are the covariances of moment, force and shaft position. The contact is at the minimum of chi2.
The 95 % confidence region is where chi2 is below this minimum plus 3.84. A force along the shaft, or one whose line
crosses the shaft twice, gives a long interval or several intervals. The location is then ambiguous, and the result
reports the ambiguity. chi2 at the tip tests the assumption of a tip load. With a true tip load, noise lets chi2 exceed
`CHI_SQUARE_999_THREE_DOF` only once in a thousand evaluations.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from core.calibration.measurements import Noise
from core.calibration.rigid_transform import cross_matrix
from core.control.sensors import FusedLoad
from core.errors import CtrError
from core.model.solution import Solution, pure_force
from core.model.statics import Statics
from core.robot.robot import Array

#: 95 % quantile of chi square with one degree of freedom; it bounds the contact's confidence intervals.
CHI_SQUARE_95_ONE_DOF = 3.841
#: 99.9 % quantile of chi square with three degrees of freedom.
CHI_SQUARE_999_THREE_DOF = 16.266
#: Smallest force whose contact can be located [N].
MIN_FORCE_N = 0.05
#: Largest total length of the confidence intervals of a located contact [m].
MAX_INTERVAL_M = 0.040
#: Spacing of the first search grid along the shaft [m], before the minimum of chi square is refined.
GRID_SPACING_M = 0.005
#: Standard deviation of each component of the model's shaft position [m].
SHAPE_STD_M = 0.3e-3


class TipLoad(NamedTuple):
    """Test result of the assumption that the load acts at the tip."""

    closure: float  #: size of the moment mismatch |M - r_tip x F| [N m]
    statistic: float  #: chi square of the closure, three degrees of freedom
    accepted: bool  #: False: the load acts elsewhere, or there is more than one load


class ContactLocation(NamedTuple):
    """Estimated location of a load on the shaft, with its uncertainty."""

    arc_length: float  #: distance of the contact from the plate along the shaft [m]
    point: Array  #: (3,) position of the contact, world frame [m]
    intervals: tuple[tuple[float, float], ...]  #: 95 % confidence intervals of the arc length [m]
    statistic: float  #: chi square at `arc_length`; large when no single force explains the moment
    located: bool  #: whether the total length of the intervals is at most `MAX_INTERVAL_M`
    note: str  #: human-readable reason if the contact is not located; else empty


def evaluate_tip_load(load: FusedLoad, tip: Array, noise: Noise) -> TipLoad:
    """Test the assumption that the load acts at the tip (3,) [m]."""
    closure = load.moment - np.cross(tip, load.force)
    statistic = float(closure @ np.linalg.solve(_covariance(tip, load.force, noise), closure))
    return TipLoad(float(np.linalg.norm(closure)), statistic, statistic <= CHI_SQUARE_999_THREE_DOF)


def locate_contact(statics: Statics, joints: Array, load: FusedLoad, noise: Noise) -> ContactLocation | None:
    """Return the location where one force explains the base sensors' load; None for a force below `MIN_FORCE_N`.

    Args:
        statics: model of the robot; base moments are about the world's origin.
        joints: joint positions (n,) [rad or m].
        load: sum of the base wrenches, world frame.
        noise: standard deviations of this sum.

    Raises:
        CtrError: the model has no shape under this force anywhere on the shaft.

    """
    if float(np.linalg.norm(load.force)) < MIN_FORCE_N:
        return None
    robot = statics.robot
    length = max(float(robot.tube_ends(joints).max()), 0.0)  # a retracted tip: outer tubes reach beyond it
    grid = np.linspace(0.0, length, max(8, round(length / GRID_SPACING_M)) + 1)
    search = _Search(statics, joints, load, noise)
    values = np.array([search.chi2(s) for s in grid])
    best = int(np.argmin(values))
    s = search.refine(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    least = search.chi2(s)
    intervals = search.intervals(grid, values, s, least)
    total = sum(end - start for start, end in intervals)
    note = ""
    if total > MAX_INTERVAL_M:
        note = f"the force is along the shaft, or its line meets the shaft more than once: {contact_spans(intervals)}"
    return ContactLocation(s, search.point(s), intervals, least, total <= MAX_INTERVAL_M, note)


def contact_spans(intervals: Sequence[tuple[float, float]]) -> str:
    """Return human-readable text for intervals (start, end) [m] along the shaft."""
    return " or ".join(f"{1e3 * start:.0f} ... {1e3 * end:.0f} mm" for start, end in intervals)


class _Search:
    """Chi square of a contact along the shaft; the model is solved with the force at each evaluated arc length."""

    def __init__(self, statics: Statics, joints: Array, load: FusedLoad, noise: Noise) -> None:
        self._statics, self._joints, self._load, self._noise = statics, joints, load, noise
        self._wrench = pure_force(load.force)
        self._near: Solution | None = None

    def point(self, s: float) -> Array:
        """Return the position (3,) [m] of the shaft at arc length `s` [m], loaded with the force at this position."""
        try:
            self._near = self._statics.solve(self._joints, self._wrench, self._near, s)
        except CtrError:
            self._near = self._statics.solve(self._joints, self._wrench, None, s)
        path = self._statics.shape(self._near)
        return _on_curve(path, s)

    def chi2(self, s: float) -> float:
        """Return chi square of the moment's mismatch with the force at arc length `s` [m]."""
        point = self.point(s)
        closure = self._load.moment - np.cross(point, self._load.force)
        return float(closure @ np.linalg.solve(_covariance(point, self._load.force, self._noise), closure))

    def refine(self, start: float, end: float) -> float:
        """Return the arc length of the minimum between two arc lengths, to 0.05 mm."""
        from scipy.optimize import minimize_scalar  # pyright: ignore  - slow to import

        found: Any = minimize_scalar(self.chi2, bounds=(start, end), method="bounded", options={"xatol": 2.5e-5})
        return float(found.x)

    def intervals(self, grid: Array, values: Array, s: float, least: float) -> tuple[tuple[float, float], ...]:
        """Return the arc length intervals in which chi square is below its minimum + `CHI_SQUARE_95_ONE_DOF`."""
        level = least + CHI_SQUARE_95_ONE_DOF
        order = np.argsort(np.append(grid, s))
        where, height = np.append(grid, s)[order], np.append(values, least)[order]
        inside = height <= level
        found: list[tuple[float, float]] = []
        k = 0
        while k < len(where):
            if not inside[k]:
                k += 1
                continue
            first = k
            while k + 1 < len(where) and inside[k + 1]:
                k += 1
            start = where[first] if first == 0 else self._crossing(where[first - 1], where[first], level)
            end = where[k] if k == len(where) - 1 else self._crossing(where[k + 1], where[k], level)
            found.append((float(start), float(end)))
            k += 1
        return tuple(found)

    def _crossing(self, outside: float, inside: float, level: float) -> float:
        """Return the arc length at which chi square crosses `level`, between two points, to 0.1 mm."""
        while abs(outside - inside) > 1e-4:
            middle = 0.5 * (outside + inside)
            if self.chi2(middle) <= level:
                inside = middle
            else:
                outside = middle
        return inside


def _on_curve(path: Array, s: float) -> Array:
    """Return the position (3,) at arc length `s`, interpolated between the cross-sections of `Statics.shape`."""
    after = int(np.clip(np.searchsorted(path[:, 0], s), 1, len(path) - 1))
    a, b = path[after - 1], path[after]
    length = float(b[0] - a[0])
    if length < 1e-12:
        return b[10:13].copy()
    t = (s - float(a[0])) / length
    # Interpolate by the cubic through both ends with their tangents: its error over a sub-link is below a micrometre.
    start, end = a[10:13], b[10:13]
    return (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * start + t * (1.0 - t) ** 2 * length * a[3:10:3]
        + t * t * (3.0 - 2.0 * t) * end + t * t * (t - 1.0) * length * b[3:10:3]
    )  # fmt: skip


def _covariance(point: Array, force: Array, noise: Noise) -> Array:
    """Return the covariance (3, 3) of the moment mismatch M - r x F [N^2 m^2]."""
    lever, pull = cross_matrix(point), cross_matrix(force)
    return noise.moment**2 * np.eye(3) + noise.force**2 * lever @ lever.T + SHAPE_STD_M**2 * pull @ pull.T
