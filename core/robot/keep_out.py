"""Forbidden and allowed regions of the workspace, and the limit that keeps the loaded tubes out of them or inside them.

A region has a signed distance to each point, negative inside. The clearance of the tubes is the smallest distance of
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

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.errors import DescriptionError, PoseError
from core.robot.limits import BRAKING_TIME_CONSTANT_S, Backbone, LimitContext, built_in
from core.robot.robot import Array

#: Names of the parts of the tubes; each has rows of the limit, for its point that is nearest to the region.
PARTS = ("first quarter", "second quarter", "third quarter", "last quarter", "end of an outer tube")
#: Kinds of regions in packed numbers.
SPHERE, CAPSULE, BOX, HALF_SPACE, MESH = range(5)
#: Edge of the cells in which the nearest triangles of a mesh are looked up, and distance that the cells cover [m].
CELL_M, REACH_M = 0.005, 0.030
#: Clearance beyond which the nearest point between two points of the tubes is not searched [m].
FAR_M = 0.010
#: Clearance beyond which a part of the tubes has only the row of its nearest point [m].
NEAR_M = 0.004
#: Distance from the nearest point at which the surface is probed, forward and back along each axis [m].
PROBE_M = 0.002
#: Distance of the two further points of the tubes from the nearest point, over the distance of the points.
NEIGHBOUR = 0.5
#: Rows of each part of the tubes: those of its nearest point, of the probes, and of the two further points.
PROBES = 6
ROWS = 1 + PROBES + 2
#: Distance by which the clearance may be missed, because the limit lets the tubes come close to the margin [m].
TOLERANCE_M = 1e-4
#: Clearance at which the tubes stop [m]; the noise of the observed tip changes the clearance by about as much.
RESERVE_M = 5e-5
#: Time constant of a retreat [s], twice the delay of the stages.
RETREAT_TIME_S = 0.15
#: Largest number of triangles of a mesh, and of its cells.
MAX_TRIANGLES, MAX_CELLS = 100_000, 400_000


class Mesh(NamedTuple):
    """Closed surface of triangles, with the candidates for the nearest triangle to the points of each cell."""

    triangles: Array  #: (t, 3, 3) corners, world frame [m]; seen from outside they are counter-clockwise
    normals: Array  #: (t, 3) outward unit vectors
    spheres: Array  #: (t, 4) centre and radius of a sphere around each triangle [m]
    origin: Array  #: (3,) corner of the first cell [m]
    size: NDArray[np.int64]  #: (3,) number of cells along each axis
    starts: NDArray[np.int64]  #: (cells + 1,) index of the first candidate of each cell
    candidates: NDArray[np.int64]  #: (k,) indices of triangles, for each cell the nearest to its centre first
    distances: Array  #: (k,) their distances from the centre of the cell [m]


#: Mesh of regions that have none.
NO_MESH = Mesh(
    np.empty((0, 3, 3)),
    np.empty((0, 3)),
    np.empty((0, 4)),
    np.zeros(3),
    np.zeros(3, np.int64),
    np.zeros(1, np.int64),
    np.empty(0, np.int64),
    np.empty(0),
)


def mesh(triangles: Array) -> Mesh:
    """Return the mesh of closed, outward triangles (t, 3, 3) [m].

    Raises:
        DescriptionError: no triangle, too many, or corners that are not finite.
    """
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 3) or not 0 < len(triangles) <= MAX_TRIANGLES:
        raise DescriptionError(f"a mesh has {len(triangles)} triangles; 1 ... {MAX_TRIANGLES} are possible")
    if not np.isfinite(triangles).all():
        raise DescriptionError("a mesh has corners that are not finite")
    corners = triangles.reshape(-1, 3)
    origin = corners.min(axis=0) - REACH_M
    size = np.ceil((corners.max(axis=0) + REACH_M - origin) / CELL_M).astype(np.int64)
    if np.prod(size.astype(float)) > MAX_CELLS:
        extent = (1e3 * np.ptp(corners, axis=0)).round().astype(int).tolist()
        raise DescriptionError(
            f"a mesh of {extent} mm is too large; is its unit right? Cut it to the robot's workspace"
        )
    triangles = np.ascontiguousarray(triangles)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    centroids = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centroids[:, None], axis=2).max(axis=1)
    spheres = np.column_stack((centroids, radii * (1.0 + 1e-9)))  # rounding must not leave a corner outside
    return Mesh(triangles, normals, spheres, origin, size, *_candidates(triangles, spheres, origin, size))


@dataclass(frozen=True)
class Region:
    """A region of the workspace, world frame."""

    name: str
    kind: Literal["sphere", "capsule", "box", "half_space", "mesh"]
    #: sphere: centre, radius; capsule: two ends, radius; box: centre, half edges, rotation (9, by rows); half-space:
    #: point, outward normal; mesh: none [m]
    numbers: tuple[float, ...]
    inside: bool = False  #: whether the tubes must stay inside instead of outside
    margin: float = 0.001  #: smallest allowed distance between region and tubes [m]
    mesh: Mesh = NO_MESH

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.numbers, self.margin))):
            raise DescriptionError(f"region '{self.name}' has a number that is not finite")
        if self.kind == "half_space" and abs(math.hypot(*self.numbers[3:6]) - 1.0) > 1e-6:
            raise DescriptionError(f"region '{self.name}': the normal must have length 1")

    @cached_property
    def packed(self) -> Array:
        """Kind, sign (-1: the tubes must stay inside), margin, and the numbers, padded (18,)."""
        kind = ("sphere", "capsule", "box", "half_space", "mesh").index(self.kind)
        return np.array([kind, -1.0 if self.inside else 1.0, self.margin, *self.numbers, *[0.0] * 18])[:18]

    def distance(self, point: Array) -> tuple[float, Array]:
        """Return the signed distance of a point (3,) [m], negative inside, and the direction (3,) of its growth."""
        direction = np.zeros(3)
        return float(_distance(self.packed, self.mesh, point, direction)), direction


class Clearance(NamedTuple):
    """Clearance between a region and the tubes."""

    distance: float  #: distance of the tubes' surface to the region, less the margin [m]
    point: Array  #: (3,) nearest point on the tubes' centre line [m]
    direction: Array  #: (3,) unit vector along which the clearance grows
    nearest: Array  #: (3,) nearest point of the region's surface [m]


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
        rows, signed, _ = self.evaluated(at.backbone)
        return rows, np.maximum(signed, 0.0)

    def smallest_distance(self, near: Backbone) -> float:
        """Return the distance of `clearance` [m]."""
        return float(self.evaluated(near)[2][:, 0].min())

    def clearance(self, near: Backbone) -> Clearance:
        """Return the smallest clearance of tubes along `near`."""
        parts = self.evaluated(near)[2]
        best = parts[int(parts[:, 0].argmin())]
        point, direction = best[1:4].copy(), best[4:].copy()
        away = abs(self.region.distance(point)[0])
        return Clearance(float(best[0]), point, direction, point - away * direction)

    def evaluated(self, near: Backbone) -> tuple[Array, Array, Array]:
        """Return rows (5 `ROWS`, n), signed room, and clearance, nearest point and direction of each part (5, 7).

        Where the room is negative, a retreat is necessary, with this speed [m/s].
        """
        last = self.__dict__.get("_last")  # a tick evaluates a limit three times
        if last is not None and last[0] is near:
            return last[1]
        m = len(PARTS) * ROWS
        found = np.zeros((m, near.jacobian.shape[2])), np.empty(m), np.empty((len(PARTS), 7))
        _rows(self.region.packed, *self.region.mesh, *near, BRAKING_TIME_CONSTANT_S, RETREAT_TIME_S, *found)
        self.__dict__["_last"] = near, found
        return found

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
    region: Array, triangles: Array, normals: Array, spheres: Array, origin: Array, size: NDArray[np.int64],
    starts: NDArray[np.int64], candidates: NDArray[np.int64], distances: Array, points: Array, radii: Array,
    jacobian: Array, drift: Array, ahead: Array, along: int, braking: float, retreat: float, rows: Array, room: Array,
    nearest: Array,
) -> None:  # fmt: skip
    """Compute rows, signed room, and for each part the clearance, the nearest point and the direction of growth."""
    surface = Mesh(triangles, normals, spheres, origin, size, starts, candidates, distances)
    sign, margin, quarters = region[1], region[2], nearest.shape[0] - 1
    point, probe, normal, vector = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    room[:], nearest[:, 0] = 1.0 / braking, np.inf
    for part in range(nearest.shape[0]):
        first, last = part * (along - 1) // quarters, (part + 1) * (along - 1) // quarters
        if part == quarters:
            first, last = along, points.shape[0] - 1
        at, best = _nearest_index(region, surface, points, radii, first, last)
        if at < 0:
            continue  # a robot of one tube has no outer ends
        share, between = 0.0, at < along and along > 2
        if best < FAR_M and between:
            end, at = at - min(max(at, 1), along - 2), min(max(at, 1), along - 2)  # the ends have one neighbour
            share = _nearest_share(region, surface, points, at, end, best + radii[at + end])
        _between(points, at, share, point)
        best = sign * _distance(region, surface, point, normal) - radii[at + int(np.floor(share))] - margin
        nearest[part, 0] = best
        for k in range(3):
            nearest[part, 1 + k], nearest[part, 4 + k] = point[k], sign * normal[k]
        for number in range(ROWS if best < NEAR_M else 1):
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
            left = sign * _distance(region, surface, probe, normal) - radius - margin - RESERVE_M
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


@compiled
def _nearest_index(
    region: Array, surface: Mesh, points: Array, radii: Array, first: int, last: int
) -> tuple[int, float]:
    """Return the index of the nearest point from `first` to `last`, and the distance of the tubes there.

    The index is -1 if there are no points.
    """
    best, at, reachable, direction = np.inf, -1, -np.inf, np.empty(3)
    for i in range(first, last + 1):
        if i > first:  # the distance changes at most as much as the point moves
            reachable -= np.sqrt(_square(points[i], points[i - 1]))
        if reachable > best:
            continue
        distance = region[1] * _distance(region, surface, points[i], direction) - radii[i]
        reachable = distance + radii[i] - max(radii[first], radii[last])
        if distance < best:
            best, at = distance, i
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
        there = region[1] * _distance(region, surface, point, direction)
        nearer, farther = (other, share) if there < best else (share, other)
        if number > 0 and farther < nearer:
            low = farther
        elif number > 0:
            high = farther
        share, best = nearer, min(there, best)
    return share if best < distance else float(end)


@compiled
def _distance(region: Array, surface: Mesh, point: Array, direction: Array) -> float:
    """Return the signed distance of a point, negative inside; write the direction in which it grows."""
    kind, numbers = int(region[0]), region[3:]
    if kind == MESH:
        return _mesh_distance(surface, point, direction)
    if kind == HALF_SPACE:
        distance = 0.0
        for k in range(3):
            direction[k] = numbers[3 + k]
            distance += (point[k] - numbers[k]) * numbers[3 + k]
        return distance
    if kind == BOX:
        return _box_distance(numbers, point, direction)
    share = 0.0
    if kind == CAPSULE:
        square = 0.0
        for k in range(3):
            axis = numbers[3 + k] - numbers[k]
            share += axis * (point[k] - numbers[k])
            square += axis * axis
        share = min(max(share / square, 0.0), 1.0) if square > 0.0 else 0.0
    for k in range(3):
        direction[k] = point[k] - numbers[k]
        if kind == CAPSULE:
            direction[k] -= share * (numbers[3 + k] - numbers[k])
    return _normalised(direction) - numbers[6 if kind == CAPSULE else 3]


@compiled
def _normalised(direction: Array) -> float:
    """Scale a vector to length 1 and return its former length; a vector of length 0 becomes the z axis."""
    length = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    for k in range(3):
        direction[k] = direction[k] / length if length > 0.0 else (1.0 if k == 2 else 0.0)
    return length


@compiled
def _box_distance(numbers: Array, point: Array, direction: Array) -> float:
    """Compute `_distance` for a box: centre, half edges, rotation by rows."""
    local, out = np.zeros(3), np.zeros(3)
    deepest, axis, outside = -np.inf, 0, 0.0
    for k in range(3):
        for i in range(3):
            local[k] += numbers[6 + 3 * i + k] * (point[i] - numbers[i])
        beyond = abs(local[k]) - numbers[3 + k]
        out[k] = (1.0 if local[k] >= 0.0 else -1.0) * max(beyond, 0.0)
        outside += out[k] * out[k]
        if beyond > deepest:
            deepest, axis = beyond, k
    if outside == 0.0:
        out[axis] = 1.0 if local[axis] >= 0.0 else -1.0
    for i in range(3):
        direction[i] = 0.0
        for k in range(3):
            direction[i] += numbers[6 + 3 * i + k] * out[k]
    _normalised(direction)
    return np.sqrt(outside) if outside > 0.0 else deepest


@compiled
def _mesh_distance(surface: Mesh, point: Array, direction: Array) -> float:
    """Compute `_distance` for a mesh; beyond its cells the distance is `REACH_M` without a direction."""
    cell = 0
    for k in range(3):
        index = int(np.floor((point[k] - surface.origin[k]) / CELL_M))
        if not 0 <= index < surface.size[k]:
            direction[:] = 0.0
            return REACH_M
        cell = cell * surface.size[k] + index
    best, reachable, side, offset, from_centre = np.inf, np.inf, 1.0, np.empty(3), 0.0
    for k in range(3):
        within = point[k] - surface.origin[k]
        from_centre += (within - CELL_M * (np.floor(within / CELL_M) + 0.5)) ** 2
    from_centre = np.sqrt(from_centre)
    for i in range(surface.starts[cell], surface.starts[cell + 1]):
        if surface.distances[i] - from_centre > reachable:
            break
        candidate = surface.candidates[i]
        if not _may_reach(surface.normals, surface.spheres, candidate, point, reachable):
            continue
        square = _to_triangle(surface.triangles, candidate, point, offset)
        if square > best * (1.0 + 1e-9):
            continue
        # At an edge or a corner several triangles are equally near; the one that the point is farthest from as a plane
        # decides whether the point is inside.
        normal = surface.normals[candidate]
        height = normal[0] * offset[0] + normal[1] * offset[1] + normal[2] * offset[2]
        if square < best * (1.0 - 1e-9) or abs(height) > abs(side):
            side = height
        if square < best:
            best, reachable = square, np.sqrt(square) * (1.0 + 1e-9)
        for k in range(3):
            direction[k] = offset[k]
    distance = _normalised(direction)
    if distance < 1e-9:  # on the surface: grows along the normal of the triangle
        return 0.0
    if side < 0.0:
        for k in range(3):
            direction[k] = -direction[k]
        return -distance
    return distance


@compiled
def _product(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors (3,), faster than a call of a library."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _square(a: Array, b: Array) -> float:
    """Return the square of the distance of two points [m^2]."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@compiled
def _may_reach(normals: Array, spheres: Array, t: int, point: Array, reachable: float) -> bool:
    """Return False if triangle number t is certainly farther from `point` than `reachable` [m].

    The triangle is inside a disc of its plane, around the centre of its sphere.
    """
    height, square = 0.0, 0.0
    for k in range(3):
        offset = point[k] - spheres[t, k]
        height += normals[t, k] * offset
        square += offset * offset
    left = reachable * reachable - height * height
    return left >= 0.0 and square - height * height <= (spheres[t, 3] + np.sqrt(left)) ** 2


@compiled
def _to_triangle(triangles: Array, t: int, point: Array, offset: Array) -> float:
    """Write the vector from the nearest point of triangle number t to `point`; return its square [m^2].

    The nearest point is found by the regions of Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        ab, ac = triangles[t, 1, k] - triangles[t, 0, k], triangles[t, 2, k] - triangles[t, 0, k]
        d1 += ab * (point[k] - triangles[t, 0, k])
        d2 += ac * (point[k] - triangles[t, 0, k])
        d3 += ab * (point[k] - triangles[t, 1, k])
        d4 += ac * (point[k] - triangles[t, 1, k])
        d5 += ab * (point[k] - triangles[t, 2, k])
        d6 += ac * (point[k] - triangles[t, 2, k])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0  # nearest point: corner 0 + v (corner 1 - corner 0) + w (corner 2 - corner 0)
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    square = 0.0
    for k in range(3):
        nearest = (1.0 - v - w) * triangles[t, 0, k] + v * triangles[t, 1, k] + w * triangles[t, 2, k]
        offset[k] = point[k] - nearest
        square += offset[k] * offset[k]
    return square


def _candidates(
    triangles: Array, spheres: Array, origin: Array, size: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the triangles that can be nearest to a point of each cell: `starts`, `candidates`, `distances`."""
    import scipy.spatial  # pyright: ignore[reportMissingTypeStubs] # only for meshes, because its import takes a third of a second

    index = np.indices(tuple(size.tolist())).reshape(3, -1).T
    centres = origin + CELL_M * (index + 0.5)
    tree, diagonal = cast(Any, scipy.spatial).KDTree(spheres[:, :3]), math.sqrt(3.0) * CELL_M
    largest = float(spheres[:, 3].max())
    bounds: Array = tree.query(centres)[0]
    starts, found, away = np.zeros(len(centres) + 1, np.int64), list[NDArray[np.int64]](), list[Array]()
    for cell, (centre, bound) in enumerate(zip(centres, bounds, strict=True)):
        near = np.array(tree.query_ball_point(centre, bound + diagonal + largest), np.int64)
        distances = _distances(triangles, near, centre)
        order = np.argsort(distances, kind="stable")
        order = order[distances[order] <= distances.min() + diagonal]
        found.append(near[order])
        away.append(distances[order])
        starts[cell + 1] = starts[cell] + order.size
    return starts, np.concatenate(found), np.concatenate(away)


@compiled
def _distances(triangles: Array, near: NDArray[np.int64], point: Array) -> Array:
    """Return the distances [m] of the triangles `near` (k,) to a point."""
    found, offset = np.empty(near.shape[0]), np.empty(3)
    for i in range(near.shape[0]):
        found[i] = np.sqrt(_to_triangle(triangles, near[i], point, offset))
    return found
