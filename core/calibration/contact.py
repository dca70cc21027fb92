"""Where on the shaft a load acts, from the base moment that a tip load would not need.

A force F at the place r(s) of the shaft gives the sum of the base sensors the moment M = r(s) x F. Along the
shaft, bent by that force at that place, the mismatch

    c(s) = M - r(s) x F,    chi2(s) = c^T S^-1 c,    S = S_M + [r x] S_F [r x]^T + [F x] S_r [F x]^T

is looked at; its least value is the contact, and where it stays below the least value plus 3.84 the contact may
be with 95 % confidence. A force along the shaft, or one whose line passes the shaft twice, leaves a long interval or
several: the geometry does not tell, and the answer says so. At the tip chi2 tells whether the assumption of a tip load
holds: three components of noise exceed `TIP_LOAD` once in a thousand.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.measurements import Noise
from core.calibration.rigid import cross_matrix
from core.control.force_fusion import Fused
from core.errors import CtrError
from core.model.solution import Solution, pure_force
from core.model.statics import Statics
from core.robot.robot import Array

#: Quantile of chi square for one unknown, 95 %.
INTERVAL = 3.841
#: Of chi square with three degrees of freedom, 99.9 %.
TIP_LOAD = 16.266
#: Below this a force is too small to say where it acts [N].
LEAST_FORCE = 0.05
#: An interval longer than this does not locate a contact [m].
LOCATED = 0.040
#: Between two places that are tried first [m]; afterwards the least value is closed in on.
GRID = 0.005
#: How well the model knows where the shaft is: standard deviation of each component [m].
SHAPE = 0.3e-3


class TipLoad(NamedTuple):
    """Whether the load acts at the tip."""

    closure: float  #: |M - r_tip x F| [N m]
    statistic: float  #: chi square of it, three degrees of freedom
    holds: bool  #: False: the load acts elsewhere, or there is more than one


class Contact(NamedTuple):
    """Where a load acts on the shaft."""

    place: float  #: arc length from the plate [m]
    point: Array  #: (3,) world frame [m]
    intervals: tuple[tuple[float, float], ...]  #: where it may be, 95 % [m]
    statistic: float  #: chi square at the best place; large when no single force explains the moment
    located: bool  #: all the intervals together are short
    note: str  #: why not, for a person; empty when it is


def tip_load(load: Fused, tip: Array, noise: Noise) -> TipLoad:
    """Test the assumption that the load acts at the tip (3,) [m]."""
    closure = load.moment - np.cross(tip, load.force)
    statistic = float(closure @ np.linalg.solve(_covariance(tip, load.force, noise), closure))
    return TipLoad(float(np.linalg.norm(closure)), statistic, statistic <= TIP_LOAD)


def locate(statics: Statics, joints: Array, load: Fused, noise: Noise) -> Contact | None:
    """Find the place where one force explains force and moment; None when the force is below `LEAST_FORCE`.

    Args:
        statics: the model, its base moments about the world's origin.
        joints: (n,) [rad or m].
        load: fused, world frame.
        noise: of the fused load.

    Raises:
        CtrError: the model has no shape under this force anywhere on the shaft.

    """
    if float(np.linalg.norm(load.force)) < LEAST_FORCE:
        return None
    robot = statics.robot
    length = float(robot.tube_poses(joints)[1][0]) + robot.tubes[0].length
    places = np.linspace(0.0, length, max(8, round(length / GRID)) + 1)
    search = _Search(statics, joints, load, noise)
    values = np.array([search.chi2(place) for place in places])
    best = int(np.argmin(values))
    place = search.refine(places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)])
    least = search.chi2(place)
    intervals = search.intervals(places, values, place, least)
    total = sum(end - start for start, end in intervals)
    note = ""
    if total > LOCATED:
        note = f"the force acts along the shaft, or its line passes the shaft more than once: {spans(intervals)}"
    return Contact(place, search.point(place), intervals, least, total <= LOCATED, note)


def spans(intervals: Sequence[tuple[float, float]]) -> str:
    """Places (start, end) [m] along the shaft for a reader."""
    return " or ".join(f"{1e3 * start:.0f} ... {1e3 * end:.0f} mm" for start, end in intervals)


class _Search:
    """Chi square along the shaft; every place is solved with the force there."""

    def __init__(self, statics: Statics, joints: Array, load: Fused, noise: Noise) -> None:
        self._statics, self._joints, self._load, self._noise = statics, joints, load, noise
        self._wrench = pure_force(load.force)
        self._near: Solution | None = None

    def point(self, place: float) -> Array:
        """The loaded shaft (3,) at arc length `place` [m]."""
        try:
            self._near = self._statics.solve(self._joints, self._wrench, self._near, place)
        except CtrError:
            self._near = self._statics.solve(self._joints, self._wrench, None, place)
        path = self._statics.shape(self._near)
        return _on_curve(path, place)

    def chi2(self, place: float) -> float:
        """Mismatch of the moment with the force at `place` [m]."""
        point = self.point(place)
        closure = self._load.moment - np.cross(point, self._load.force)
        return float(closure @ np.linalg.solve(_covariance(point, self._load.force, self._noise), closure))

    def refine(self, start: float, end: float) -> float:
        """Least value between two places, to 0.05 mm, by golden sections."""
        golden = 0.6180339887498949
        low, high = end - golden * (end - start), start + golden * (end - start)
        at_low, at_high = self.chi2(low), self.chi2(high)
        while end - start > 5e-5:
            if at_low < at_high:
                end, high, at_high = high, low, at_low
                low = end - golden * (end - start)
                at_low = self.chi2(low)
            else:
                start, low, at_low = low, high, at_high
                high = start + golden * (end - start)
                at_high = self.chi2(high)
        return 0.5 * (start + end)

    def intervals(self, places: Array, values: Array, place: float, least: float) -> tuple[tuple[float, float], ...]:
        """Where chi square is below its least value + `INTERVAL`."""
        level = least + INTERVAL
        order = np.argsort(np.append(places, place))
        where, height = np.append(places, place)[order], np.append(values, least)[order]
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
        """Between a place above the level and one below it, to 0.1 mm."""
        while abs(outside - inside) > 1e-4:
            middle = 0.5 * (outside + inside)
            if self.chi2(middle) <= level:
                inside = middle
            else:
                outside = middle
        return inside


def _on_curve(path: Array, place: float) -> Array:
    """Position (3,) at an arc length, between the cross-sections of `Statics.shape`, with their directions."""
    after = int(np.clip(np.searchsorted(path[:, 0], place), 1, len(path) - 1))
    a, b = path[after - 1], path[after]
    length = float(b[0] - a[0])
    if length < 1e-12:
        return b[10:13].copy()
    t = (place - float(a[0])) / length
    # cubic through both ends with their tangents: the error over a sub-link is below a micrometre
    start, end = a[10:13], b[10:13]
    return (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * start + t * (1.0 - t) ** 2 * length * a[3:10:3]
        + t * t * (3.0 - 2.0 * t) * end + t * t * (t - 1.0) * length * b[3:10:3]
    )  # fmt: skip


def _covariance(point: Array, force: Array, noise: Noise) -> Array:
    """Of M - r x F (3, 3) [N^2 m^2]."""
    lever, pull = cross_matrix(point), cross_matrix(force)
    return noise.moment**2 * np.eye(3) + noise.force**2 * lever @ lever.T + SHAPE**2 * pull @ pull.T
