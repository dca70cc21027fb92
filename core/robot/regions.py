"""Regions of the workspace, the signed distance of a point to them (negative inside), and the direction of its growth.

The distance to a mesh is the distance to its nearest triangle. The triangle's normal determines the sign. If the
nearest point is on an edge or a corner, the mean normal there, weighted by angles, determines the sign (Baerentzen and
Aanaes 2005). The triangles are in a binary tree of boxes. A search skips boxes that are farther away than the nearest
triangle so far. It evaluates a triangle only if the disc around it in its plane could be nearer.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.robot import Array

#: Kinds of regions, as numbers in `Region.packed`.
SPHERE, CAPSULE, BOX, HALF_SPACE, MESH = range(5)
#: Largest number of triangles of a mesh, and of a leaf of its tree (a box without further boxes in it).
MAX_TRIANGLES, LEAF = 100_000, 8
#: Bounds of a mesh's largest extent [m]. They reveal a wrong unit: a file in metres that is read as millimetres is
#: smaller, and a file in millimetres that is read as metres is larger.
MIN_EXTENT_M, MAX_EXTENT_M = 1e-3, 2.0
#: Largest coordinate of a mesh [m]; rounding makes the shape of a mesh that is much farther away uncertain.
MAX_AWAY_M = 20.0
#: Size of the stack of boxes in a search: one box for each level of the tree, and each level halves the triangles.
MAX_WAITING = 32


class Mesh(NamedTuple):
    """Closed surface of triangles, in the order of the boxes that contain them."""

    triangles: Array  #: (t, 3, 3) corners, world frame [m]; seen from outside they are counter-clockwise
    normals: Array  #: (t, 3) outward unit vectors
    #: (t, 6, 3) mean normals at the corners of each triangle, and at its edges from corner 0 to 1, 1 to 2 and 2 to 0
    mean_normals: Array
    spheres: Array  #: (t, 4) centre and radius of a sphere around each triangle [m]
    boxes: Array  #: (b, 6) lowest and highest corner of each box; the first box contains all triangles [m]
    #: (b, 2) for a box of triangles: index of its first triangle, and their number. For a box of two boxes: index of
    #: the second box, and 0; the first one is the box in the next row.
    contents: NDArray[np.int64]


#: Empty mesh, for regions of the other kinds.
NO_MESH = Mesh(
    np.empty((0, 3, 3)),
    np.empty((0, 3)),
    np.empty((0, 6, 3)),
    np.empty((0, 4)),
    np.empty((0, 6)),
    np.empty((0, 2), np.int64),
)


def check_triangles(triangles: Array) -> None:
    """Check number, corners and extent of triangles (t, 3, 3) [m].

    Raises:
        DescriptionError: no triangle, too many, corners that are not finite, or an extent that is out of range.
    """
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 3) or not 0 < len(triangles) <= MAX_TRIANGLES:
        raise DescriptionError(f"a mesh has {len(triangles)} triangles; it must have 1 ... {MAX_TRIANGLES}")
    if not np.isfinite(triangles).all():
        raise DescriptionError("a mesh has corners that are not finite")
    with np.errstate(over="ignore"):
        extent = np.ptp(triangles.reshape(-1, 3), axis=0)
        size = " x ".join(f"{length:.3g}" for length in 1e3 * extent)
    if not MIN_EXTENT_M <= extent.max() <= MAX_EXTENT_M:
        raise DescriptionError(
            f"a mesh of {size} mm is too {'large' if extent.max() > MAX_EXTENT_M else 'small'} (its largest extent must"
            f" be {1e3 * MIN_EXTENT_M:g} ... {1e3 * MAX_EXTENT_M:g} mm); is its unit right? scale = 0.001 reads a file"
            " in millimetres, scale = 1.0 a file in metres"
        )
    if (away := float(np.abs(triangles).max())) > MAX_AWAY_M:
        raise DescriptionError(
            f"a mesh has a coordinate of {1e3 * away:.3g} mm (at most {1e3 * MAX_AWAY_M:g} mm); move it near the origin"
        )


def mesh(triangles: Array) -> Mesh:
    """Return the mesh of closed, outward triangles (t, 3, 3) [m]; `core.robot.closed_surface` checks that they are.

    Raises:
        DescriptionError: as `check_triangles`.
    """
    check_triangles(triangles)
    order, boxes, contents = _tree(triangles)
    triangles = np.ascontiguousarray(triangles[order])
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    centroids = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centroids[:, None], axis=2).max(axis=1)
    spheres = np.column_stack((centroids, radii * (1.0 + 1e-9)))  # rounding must not leave a corner outside
    return Mesh(triangles, normals, _mean_normals(triangles, normals), spheres, boxes, contents)


def _mean_normals(triangles: Array, normals: Array) -> Array:
    """Return `Mesh.mean_normals` (t, 6, 3); their lengths have no meaning."""
    _, indices = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces, found = indices.reshape(-1, 3), np.empty((len(triangles), 6, 3))
    after, before = np.roll(triangles, -1, axis=1) - triangles, np.roll(triangles, 1, axis=1) - triangles
    sizes = np.linalg.norm(np.cross(after, before), axis=2)
    angles = np.arctan2(sizes, np.sum(after * before, axis=2))
    ends = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2), axis=2)
    _, edges = np.unique(ends[..., 0] * (int(faces.max()) + 1) + ends[..., 1], return_inverse=True)
    for column, keys, weights in ((0, faces, angles), (3, edges.reshape(-1, 3), np.ones_like(angles))):
        for k in range(3):
            sums = np.bincount(keys.ravel(), (weights * normals[:, k, None]).ravel())
            found[:, column : column + 3, k] = sums[keys]
    return found


def _tree(triangles: Array) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Return an order of the triangles, and the boxes and contents of `Mesh` for triangles in this order."""
    order, centroids = np.arange(len(triangles)), triangles.mean(axis=1)
    boxes, contents = list[Array](), list[tuple[int, int]]()

    def add(start: int, end: int) -> None:
        inside = order[start:end]
        corners, number = triangles[inside].reshape(-1, 3), len(boxes)
        boxes.append(np.concatenate((corners.min(axis=0), corners.max(axis=0))))
        contents.append((start, end - start))
        if end - start > LEAF:
            middle = (start + end) // 2
            along = centroids[inside, int(np.ptp(centroids[inside], axis=0).argmax())]
            order[start:end] = inside[np.argpartition(along, middle - start)]
            add(start, middle)
            contents[number] = len(boxes), 0
            add(middle, end)

    add(0, len(triangles))
    return order, np.array(boxes), np.array(contents)


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
        return float(signed_distance(self.packed, self.mesh, point, direction)), direction


@compiled
def signed_distance(region: Array, surface: Mesh, point: Array, direction: Array) -> float:
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
    """Compute `signed_distance` for a box: centre, half edges, rotation by rows."""
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
    """Compute `signed_distance` for a mesh."""
    best, reachable, side, offset = np.inf, np.inf, 1.0, np.empty(3)
    waiting, squares, count = np.empty(MAX_WAITING, np.int64), np.empty(MAX_WAITING), 1
    waiting[0], squares[0] = 0, 0.0
    while count > 0:
        count -= 1
        box = waiting[count]
        if squares[count] > best * (1.0 + 1e-9):
            continue
        first, number = surface.contents[box, 0], surface.contents[box, 1]
        if number == 0:  # a box of two boxes: search the nearer one next
            near, far = box + 1, first
            to_near, to_far = _square_to_box(surface.boxes, near, point), _square_to_box(surface.boxes, far, point)
            if to_far < to_near:
                near, far, to_near, to_far = far, near, to_far, to_near
            waiting[count], squares[count] = far, to_far
            waiting[count + 1], squares[count + 1] = near, to_near
            count += 2
        for t in range(first, first + number):
            if not _may_reach(surface.normals, surface.spheres, t, point, reachable):
                continue
            square, feature = _to_triangle(surface.triangles, t, point, offset)
            if square >= best:
                continue
            best, reachable, side = square, np.sqrt(square) * (1.0 + 1e-9), 0.0
            for k in range(3):
                direction[k] = offset[k]
                normal = surface.normals[t, k] if feature < 0 else surface.mean_normals[t, feature, k]
                side += normal * offset[k]
    distance = _normalised(direction)
    if distance < 1e-9:  # on the surface, where the side of the offset is only rounding
        return 0.0
    if side < 0.0:
        for k in range(3):
            direction[k] = -direction[k]
        return -distance
    return distance


@compiled
def _square_to_box(boxes: Array, box: int, point: Array) -> float:
    """Return the square of the distance of a point to a box [m^2], 0 inside."""
    square = 0.0
    for k in range(3):
        below, above = boxes[box, k] - point[k], point[k] - boxes[box, 3 + k]
        beyond = below if below > above else above
        if beyond > 0.0:
            square += beyond * beyond
    return square


@compiled
def _may_reach(normals: Array, spheres: Array, t: int, point: Array, reachable: float) -> bool:
    """Return False if triangle number t is certainly farther from `point` than `reachable` [m].

    The triangle is inside the disc in its plane around the centre of its sphere.
    """
    height, square = 0.0, 0.0
    for k in range(3):
        offset = point[k] - spheres[t, k]
        height += normals[t, k] * offset
        square += offset * offset
    left = reachable * reachable - height * height
    return left >= 0.0 and square - height * height <= (spheres[t, 3] + np.sqrt(left)) ** 2


@compiled
def _to_triangle(triangles: Array, t: int, point: Array, offset: Array) -> tuple[float, int]:
    """Write the vector from the nearest point of triangle number t to `point`; return its square [m^2] and a feature.

    The feature is the index of `Mesh.mean_normals` if the nearest point is on a corner or an edge, else -1.

    The search distinguishes the Voronoi regions of Ericson, Real-Time Collision Detection (2005), section 5.1.5.
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
    v, w, feature = 0.0, 0.0, -1  # nearest point: corner 0 + v (corner 1 - corner 0) + w (corner 2 - corner 0)
    if d1 <= 0.0 and d2 <= 0.0:
        feature = 0
    elif d3 >= 0.0 and d4 <= d3:
        v, feature = 1.0, 1
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, feature = d1 / (d1 - d3), 3
    elif d6 >= 0.0 and d5 <= d6:
        w, feature = 1.0, 2
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w, feature = d2 / (d2 - d6), 5
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w, feature = (d4 - d3) / ((d4 - d3) + (d5 - d6)), 4
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    square = 0.0
    for k in range(3):
        nearest = (1.0 - v - w) * triangles[t, 0, k] + v * triangles[t, 1, k] + w * triangles[t, 2, k]
        offset[k] = point[k] - nearest
        square += offset[k] * offset[k]
    return square, feature
