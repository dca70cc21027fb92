"""Limit that keeps the loaded tubes out of forbidden regions of the workspace, or inside allowed ones.

The clearance of the tubes is the smallest distance of
their centre line less their radius and the region's margin; for an allowed region the distance changes its sign. The
limit slows the motion toward a region as other limits do: the clearance over `BRAKING_TIME_CONSTANT_S` bounds the
speed at which the nearest point of each part of the tubes approaches it. The clearance is that at the time when a
command takes effect. The speed with which a rising load pushes the point toward the region counts as approach.

Where the nearest wall changes, for example at an edge of a lumen, the direction of the distance jumps. Tubes that slide
along one wall would meet the next wall without braking. Therefore the surface is probed around the nearest point, and
the tangent plane of the surface nearest to each probe bounds the approach, too. Planes are left out that lie in front
of the surface, as those of a convex body do. A point on each side of the nearest point bounds rotations about it.

A load can push the tubes nearer than the margin. During a motion the robot then retreats until the clearance is zero
(`core.control.retreat`); without a motion it does not move.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.errors import PoseError
from core.robot.limits import BRAKING_TIME_CONSTANT_S, Backbone, LimitContext, built_in
from core.robot.regions import MESH, Mesh, Region, signed_distance
from core.robot.robot import Array

#: Names of the parts of the tubes; each has rows of the limit, for its point that is nearest to the region.
PARTS = ("first quarter", "second quarter", "third quarter", "last quarter", "end of an outer tube")
#: Clearance beyond which a part of the tubes has only the row of its nearest point, which is one of the points [m].
NEAR_M = 0.002
#: Distance from the nearest point at which the surface is probed, forward and back along each axis [m].
PROBE_M = 0.002
#: Distance of the two further points of the tubes from the nearest point, over the distance of the points.
NEIGHBOUR = 0.5
#: Rows of each part of the tubes: those of its nearest point, of the probes, and of the two further points.
PROBES = 6
ROWS = 1 + PROBES + 2
#: Distance by which the clearance may be missed, because the limit lets the tubes come close to the margin [m].
TOLERANCE_M = 1e-4
#: Clearance at which the tubes stop [m]; noise of the tracker and errors of the model change the clearance by as much.
RESERVE_M = 1.5e-4
#: Time constant of a retreat [s], twice the delay of the stages.
RETREAT_TIME_S = 0.15


class Clearance(NamedTuple):
    """Clearance between a region and the tubes."""

    distance: float  #: distance of the tubes' surface to the region, less the margin [m]
    point: Array  #: (3,) nearest point on the tubes' centre line [m]
    direction: Array  #: (3,) unit vector along which the clearance grows
    nearest: Array  #: (3,) nearest point of the region's surface [m]


class Evaluation(NamedTuple):
    """A region's limit, evaluated for the tubes `near`."""

    near: Backbone
    rows: Array  #: (5 `ROWS`, n) rows of the limit
    room: Array  #: (5 `ROWS`,) signed room; where it is negative, a retreat is necessary, with this speed [m/s]
    parts: Array  #: (5, 7) clearance of each part [m], its nearest point [m], and the direction in which it grows
    smallest: float  #: smallest clearance [m]
    measured: Array  #: (m, 7) place of each point when it was measured last, and the region's distance and direction


@built_in
@dataclass(frozen=True)
class KeepOut:
    """Limit that keeps the loaded tubes out of a region, or inside it."""

    region: Region

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the rows: the region and the part of the tubes."""
        return tuple(f"region '{self.region.name}' ({part})" for part in PARTS for _ in range(ROWS))

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return `ROWS` rows for each part of the tubes: the approach is at most the clearance over a time constant."""
        found = self.evaluated(at.backbone)
        return found.rows, np.maximum(found.room, 0.0)

    def smallest_distance(self, near: Backbone) -> float:
        """Return the distance of `clearance` [m]."""
        return self.evaluated(near).smallest

    def clearance(self, near: Backbone) -> Clearance:
        """Return the smallest clearance of tubes along `near`."""
        parts = self.evaluated(near).parts
        best = parts[int(parts[:, 0].argmin())]
        point, direction = best[1:4].copy(), best[4:].copy()
        away = abs(self.region.distance(point)[0])
        return Clearance(float(best[0]), point, direction, point - away * direction)

    def evaluated(self, near: Backbone) -> Evaluation:
        """Return rows, room and clearances of tubes along `near`."""
        last: Evaluation | None = self.__dict__.get("_last")  # a tick evaluates a limit three times
        if last is not None and last.near is near:
            return last
        m, points = len(PARTS) * ROWS, near.points
        arrays = np.zeros((m, near.jacobian.shape[2])), np.empty(m), np.zeros((len(PARTS), 7))
        if last is not None and len(last.measured) == len(points):
            measured = last.measured.copy()  # another thread may read it
        else:
            measured = np.full((len(points), 7), -np.inf)
        smallest = _rows(
            self.region.packed, *self.region.mesh, *near, measured, BRAKING_TIME_CONSTANT_S, RETREAT_TIME_S, *arrays
        )
        self.__dict__["_last"] = new = Evaluation(near, *arrays, smallest, measured)
        return new

    def check(self, at: LimitContext) -> None:
        """Raise PoseError where the tubes are nearer to the region than its margin."""
        found, region = self.clearance(at.backbone), self.region
        if found.distance < -TOLERANCE_M:
            side = "inside" if region.inside else "outside"
            raise PoseError(
                f"the tubes are {1e3 * (found.distance + region.margin) + 0.0:.2f} mm {side} the region '{region.name}'"
                f" near ({', '.join(f'{1e3 * x:.0f}' for x in found.point)}) mm; required: {1e3 * region.margin:g} mm"
            )


def smallest_clearance(limits: Sequence[object], near: Backbone) -> tuple[str, Clearance] | None:
    """Return name and clearance of the nearest region among `limits`; None if there is no region."""
    found = [(one.region.name, one.clearance(near)) for one in limits if isinstance(one, KeepOut)]
    return min(found, key=lambda one: one[1].distance, default=None)


def region_at(limits: Sequence[object], point: Array) -> str | None:
    """Return the name of the first region among `limits` whose margin a point (3,) [m] misses; None: there is none."""
    for limit in limits:
        if isinstance(limit, KeepOut):
            region = limit.region
            if (-1.0 if region.inside else 1.0) * region.distance(point)[0] < region.margin:
                return region.name
    return None


@compiled
def _rows(
    region: Array, triangles: Array, normals: Array, spheres: Array, boxes: Array, contents: NDArray[np.int64],
    points: Array, radii: Array, jacobian: Array, drift: Array, ahead: Array, along: int, measured: Array,
    braking: float, retreat: float, rows: Array, room: Array, parts: Array,
) -> float:  # fmt: skip
    """Compute the arrays of an `Evaluation`, and return the smallest clearance.

    `measured` is that of the last evaluation on entry; its distances that may still be the smallest are renewed.
    """
    surface = Mesh(triangles, normals, spheres, boxes, contents)
    sign, margin, quarters = region[1], region[2], parts.shape[0] - 1
    convex = region[0] != MESH and sign > 0.0
    point, probe, normal, vector = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    room[:], parts[:, 0] = 1.0 / braking, np.inf
    for part in range(parts.shape[0]):
        first, last = part * (along - 1) // quarters, (part + 1) * (along - 1) // quarters
        if part == quarters:
            first, last = along, points.shape[0] - 1
        at, best = _nearest_index(region, surface, points, radii, first, last, measured, normal)
        if at < 0:
            continue  # a robot of one tube has no outer ends
        share, between = 0.0, at < along and along > 2
        if best - margin < NEAR_M and between:
            end, at = at - min(max(at, 1), along - 2), min(max(at, 1), along - 2)  # the ends have one neighbour
            share = _nearest_share(region, surface, points, at, end, best + radii[at + end])
            _between(points, at, share, point)
            best = sign * signed_distance(region, surface, point, normal) - radii[at + int(np.floor(share))]
        else:
            _between(points, at, share, point)
        best -= margin
        parts[part, 0] = best
        for k in range(3):
            parts[part, 1 + k], parts[part, 4 + k] = point[k], sign * normal[k]
        for number in range(ROWS if best < NEAR_M else 1):
            if convex and 0 < number <= PROBES:
                continue  # its tangent planes lie in front of the surface
            place, row = share, part * ROWS + number
            if number > PROBES:
                place += NEIGHBOUR if number == ROWS - 1 else -NEIGHBOUR
                if not (between and 0.0 <= at + place <= along - 1.0):
                    continue
            _between(points, at, place, point)
            _between(ahead, at, place, vector)
            for k in range(3):
                point[k] += vector[k]
                probe[k] = point[k]
            if 0 < number <= PROBES:
                probe[(number - 1) // 2] += PROBE_M if number % 2 == 0 else -PROBE_M
            radius = radii[at + int(np.floor(place))]
            left = sign * signed_distance(region, surface, probe, normal) - radius - margin - RESERVE_M
            for k in range(3):
                normal[k] *= sign
                left += normal[k] * (point[k] - probe[k])
            if number == 0:
                best = left
            elif number <= PROBES and left < best + 1e-9:
                continue  # the surface is flat or convex
            for j in range(rows.shape[1]):
                _between(jacobian[:, :, j], at, place, vector)
                rows[row, j] = -_product(normal, vector)
            _between(drift, at, place, vector)
            pushed = min(_product(normal, vector), 0.0)  # a load that pulls away may end at any time
            room[row] = left / (braking if left > 0.0 else retreat) + pushed
    return parts[:, 0].min()


@compiled
def _nearest_index(
    region: Array, surface: Mesh, points: Array, radii: Array, first: int, last: int, measured: Array, normal: Array
) -> tuple[int, float]:
    """Return the index of the nearest point from `first` to `last`, and the distance of the tubes there.

    A distance changes at most as much as its point moves. So each measured distance less the motion since then bounds
    the present one, and only points are measured that can be the nearest. The index is -1 if there are no points.
    `normal` becomes the direction in which the region's distance grows there.
    """
    best, at = np.inf, -1
    for _ in range(last - first + 2):  # each turn but the last one measures one point
        best, at, unknown = np.inf, -1, False
        for i in range(first, last + 1):
            moved = _square(points[i], measured[i])
            bound = measured[i, 3] - np.sqrt(moved) - radii[i]
            if bound < best or at < 0:
                best, at, unknown = bound, i, moved != 0.0
        if not unknown:
            break
        measured[at, :3] = points[at]
        measured[at, 3] = region[1] * signed_distance(region, surface, points[at], measured[at, 4:])
    if at >= 0:
        for k in range(3):
            normal[k] = measured[at, 4 + k]
    return at, best


@compiled
def _between(values: Array, at: int, share: float, out: Array) -> None:
    """Write the vector between row `at` and its neighbours, quadratic; `share` is from -1 to 1."""
    for k in range(3):
        out[k] = values[at, k]
        if share != 0.0:
            slope, bend = 0.5 * (values[at + 1, k] - values[at - 1, k]), values[at + 1, k] + values[at - 1, k]
            out[k] += share * slope + share * share * (0.5 * bend - values[at, k])


@compiled
def _nearest_share(region: Array, surface: Mesh, points: Array, at: int, end: int, distance: float) -> float:
    """Return where between the neighbours of point `at` the curve is nearest to the region, from -1 to 1.

    `end` is -1 or 1 if the nearest point is the first or the last one, else 0; `distance` is that of the nearest point.
    The search is a golden section.
    """
    low, high, point, direction = -1.0 if end <= 0 else 0.0, 1.0 if end >= 0 else 0.0, np.empty(3), np.empty(3)
    share, best = low, np.inf
    for number in range(6):
        other = low + high - share if number > 0 else low + 0.381966 * (high - low)
        _between(points, at, other, point)
        there = region[1] * signed_distance(region, surface, point, direction)
        nearer, farther = (other, share) if there < best else (share, other)
        if number > 0 and farther < nearer:
            low = farther
        elif number > 0:
            high = farther
        share, best = nearer, min(there, best)
    return share if best < distance else float(end)


@compiled
def _product(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors (3,), faster than a call of a library."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _square(a: Array, b: Array) -> float:
    """Return the square of the distance of two points [m^2]."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
