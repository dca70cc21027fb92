"""Limit that keeps the loaded tubes out of forbidden regions of the workspace, or inside allowed ones.

The clearance is the smallest distance of the tubes' centre line from the region, less the tubes' radius and the
region's margin; for an allowed region the distance changes its sign. The clearance over `BRAKING_TIME_CONSTANT_S`
bounds the speed at which the nearest point of each part of the tubes approaches the region. The limit predicts the
clearance at the time when a command takes effect. The speed at which a rising load pushes a point toward the region
counts as approach.

Where the nearest wall changes, for example at an edge of a lumen, the direction of the distance jumps. Tubes that slide
along one wall would meet the next wall without braking. Therefore the limit probes the surface around the nearest
point. The tangent plane at the surface point nearest to each probe bounds the approach, too. Planes in front of the
surface are left out, for example those of a convex body. Two further points, one on each side of the nearest point,
bound rotations about it. The tubes can touch several walls at once, so all `Backbone` points of a near part have rows.

The distance of a moving point changes by no more than the point moves. A mesh whose distance changes more has a wrong
sign somewhere, and the robot could retreat into the region: `smallest_distance` and `check` then raise an error.

A load can push the tubes nearer to a region than its margin. During a motion the robot then retreats until the
clearance is zero (`core.control.retreat`); without a motion it does not move.
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
#: Clearance beyond which a part of the tubes has only one row, for its nearest point of `Backbone` [m].
NEAR_M = 0.002
#: Distance from the nearest point at which the surface is probed, in both directions along each axis [m].
PROBE_M = 0.002
#: Distance of the two further points from the nearest point of the tubes, in spacings of the `Backbone` points.
NEIGHBOUR = 0.5
#: Rows of each part of the tubes: its nearest point, the probes, the two further points, and all its `Backbone` points
#: (`GIVEN`), because a part can lie between several walls. Of 32 points along the tubes a quarter has at most 9.
PROBES, GIVEN = 6, 9
ROWS = 1 + PROBES + 2 + GIVEN
#: Largest accepted violation of the margin [m], because the limit lets the tubes come close to the margin.
TOLERANCE_M = 1e-4
#: Clearance at which the tubes stop [m]; noise of the tracker and errors of the model change the clearance by as much.
RESERVE_M = 2.5e-4
#: Largest accepted `_jump` [m]: change of a distance beyond the motion of its point. Rounding causes less.
MAX_JUMP_M = 1e-4
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
    room: Array  #: (5 `ROWS`,) signed room; where it is negative, a retreat at this speed is necessary [m/s]
    parts: Array  #: (5, 7) clearance of each part [m], its nearest point [m], and the direction in which it grows
    smallest: float  #: smallest clearance [m]
    jump: float  #: largest `_jump`: change of a distance beyond the motion of its point [m]
    measured: Array  #: (m, 7) for each point: position at its last measurement, and distance and direction there


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
        """Return the smallest clearance of tubes along `near` [m]; raise PoseError if the region's distance jumps."""
        found = self.evaluated(near)
        self._check_jump(found)
        return found.smallest

    def _check_jump(self, found: Evaluation) -> None:
        if found.jump > MAX_JUMP_M:
            raise PoseError(
                f"the distance of the tubes from the region '{self.region.name}' jumps by {1e3 * found.jump:.2g} mm"
                f" more than the tubes moved (at most {1e3 * MAX_JUMP_M:g} mm), so the region's surface is wrong;"
                " repair the region's mesh and restart the station"
            )

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
        smallest, jump = _rows(
            self.region.packed, *self.region.mesh, *near, measured, BRAKING_TIME_CONSTANT_S, RETREAT_TIME_S, *arrays
        )
        self.__dict__["_last"] = new = Evaluation(near, *arrays, smallest, jump, measured)
        return new

    def check(self, at: LimitContext) -> None:
        """Raise PoseError where the tubes are nearer to the region than its margin, or where its distance jumps."""
        self._check_jump(self.evaluated(at.backbone))
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
    """Return the name of the first region of `limits` to which a point (3,) [m] is nearer than the margin, or None."""
    for limit in limits:
        if isinstance(limit, KeepOut):
            region = limit.region
            if (-1.0 if region.inside else 1.0) * region.distance(point)[0] < region.margin:
                return region.name
    return None


@compiled
def _rows(
    region: Array, triangles: Array, normals: Array, mean_normals: Array, spheres: Array, boxes: Array,
    contents: NDArray[np.int64], points: Array, radii: Array, jacobian: Array, drift: Array, ahead: Array, along: int,
    measured: Array, braking: float, retreat: float, rows: Array, room: Array, parts: Array,
) -> tuple[float, float]:  # fmt: skip
    """Compute the arrays of an `Evaluation`, and return the smallest clearance and the largest jump.

    On entry, `measured` is that of the last evaluation; distances that could be the smallest are measured again.
    """
    surface = Mesh(triangles, normals, mean_normals, spheres, boxes, contents)
    sign, margin, quarters = region[1], region[2], parts.shape[0] - 1
    convex = region[0] != MESH and sign > 0.0
    point, probe, normal, vector = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    room[:], parts[:, 0], jump = 1.0 / braking, np.inf, 0.0
    for part in range(parts.shape[0]):
        first, last = part * (along - 1) // quarters, (part + 1) * (along - 1) // quarters
        if part == quarters:
            first, last = along, points.shape[0] - 1
        at, best, jumped = _nearest_index(region, surface, points, radii, first, last, measured, normal)
        if at < 0:
            continue  # a robot of one tube has no outer ends
        nearest, jump = at, max(jump, jumped)
        share, between = 0.0, at < along and along > 2
        if best - margin < NEAR_M and between:
            end, at = at - min(max(at, 1), along - 2), min(max(at, 1), along - 2)  # not the first or last point
            share = _nearest_share(region, surface, points, at, end, best + radii[at + end])
            _between(points, at, share, point)
            distance = sign * signed_distance(region, surface, point, normal)
            jump = max(jump, _jump(measured[nearest], point, distance))
            best = distance - radii[at + int(np.floor(share))]
        else:
            _between(points, at, share, point)
        best -= margin
        parts[part, 0] = best
        for k in range(3):
            parts[part, 1 + k], parts[part, 4 + k] = point[k], sign * normal[k]
        for number in range(ROWS if best < NEAR_M else 1):
            if convex and 0 < number <= PROBES:
                continue  # the tangent planes of a convex body lie in front of its surface
            place, middle, row = share, at, part * ROWS + number
            if number >= ROWS - GIVEN:
                place, middle = 0.0, first + number - (ROWS - GIVEN)
                if middle > last:
                    break
            elif number > PROBES:
                place += NEIGHBOUR if number == PROBES + 2 else -NEIGHBOUR
                if not (between and 0.0 <= at + place <= along - 1.0):
                    continue
            _between(points, middle, place, point)
            _between(ahead, middle, place, vector)
            for k in range(3):
                point[k] += vector[k]
                probe[k] = point[k]
            if 0 < number <= PROBES:
                probe[(number - 1) // 2] += PROBE_M if number % 2 == 0 else -PROBE_M
            radius = radii[middle + int(np.floor(place))]
            distance = sign * signed_distance(region, surface, probe, normal)
            jump = max(jump, _jump(measured[nearest], probe, distance))
            left = distance - radius - margin - RESERVE_M
            for k in range(3):
                normal[k] *= sign
                left += normal[k] * (point[k] - probe[k])
            if number == 0:
                best = left
            elif number <= PROBES and left < best + 1e-9:
                continue  # the surface is flat or convex
            for j in range(rows.shape[1]):
                _between(jacobian[:, :, j], middle, place, vector)
                rows[row, j] = -_product(normal, vector)
            _between(drift, middle, place, vector)
            pushed = min(_product(normal, vector), 0.0)  # a load that pulls away may end at any time
            room[row] = left / (braking if left > 0.0 else retreat) + pushed
    return parts[:, 0].min(), jump


@compiled
def _nearest_index(
    region: Array, surface: Mesh, points: Array, radii: Array, first: int, last: int, measured: Array, normal: Array
) -> tuple[int, float, float]:
    """Return the index of the nearest point from `first` to `last`, the distance of the tubes there, and a jump.

    The jump is the largest of `_jump` between two measurements of a point, and between a point and the one before it.

    A distance changes by no more than its point moves. Each measured distance less the motion since then is therefore
    a lower bound, and only points that can be the nearest are measured. The index is -1 if there are no points.
    `normal` becomes the direction in which the region's distance grows there.
    """
    best, at, jump, direction = np.inf, -1, 0.0, np.empty(3)
    for _ in range(last - first + 2):  # each iteration but the last one measures one point
        best, at, unknown = np.inf, -1, False
        for i in range(first, last + 1):
            moved = _square(points[i], measured[i])
            bound = measured[i, 3] - np.sqrt(moved) - radii[i]
            if bound < best or at < 0:
                best, at, unknown = bound, i, moved != 0.0
        if not unknown:
            break
        distance = region[1] * signed_distance(region, surface, points[at], direction)
        jump = max(
            jump, _jump(measured[at], points[at], distance), _jump(measured[max(at - 1, 0)], points[at], distance)
        )
        measured[at, :3], measured[at, 3], measured[at, 4:] = points[at], distance, direction
    if at >= 0:
        for k in range(3):
            normal[k] = measured[at, 4 + k]
    return at, best, jump


@compiled
def _jump(measured: Array, point: Array, distance: float) -> float:
    """Return by how much a distance differs from a measured one beyond the distance between both points [m]."""
    if not np.isfinite(measured[3]):
        return 0.0
    return abs(distance - measured[3]) - np.sqrt(_square(point, measured))


@compiled
def _between(values: Array, at: int, share: float, out: Array) -> None:
    """Write the vector between row `at` and its neighbours (`share` -1 ... 1), by quadratic interpolation."""
    for k in range(3):
        out[k] = values[at, k]
        if share != 0.0:
            slope, bend = 0.5 * (values[at + 1, k] - values[at - 1, k]), values[at + 1, k] + values[at - 1, k]
            out[k] += share * slope + share * share * (0.5 * bend - values[at, k])


@compiled
def _nearest_share(region: Array, surface: Mesh, points: Array, at: int, end: int, distance: float) -> float:
    """Return the share (-1 ... 1) between the neighbours of point `at` at which the curve is nearest to the region.

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
