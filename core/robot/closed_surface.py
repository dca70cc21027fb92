"""Check that triangles enclose bodies, and turn them outward, so that the sign of a mesh's distance is right.

The nearest triangle determines the sign of the distance (`core.robot.regions`). The sign is right if the winding number
of the surface is 0 outside and 1 inside. A surface has this property if each of its bodies is closed, faces outward and
does not touch itself or another body. Triangles and bodies that face inward are turned, because only one result is
possible. All other faults are rejected, because the intended shape is unknown.

Finally the winding number on both sides of each triangle is compared with the sign of the distance. The winding number
is the number of triangles through which a ray leaves, less the number through which it enters.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.regions import MAX_WAITING, Mesh, check_triangles, mesh, signed_distance
from core.robot.robot import Array

#: Distance below which corners are the same corner [m].
SAME_CORNER_M = 1e-6
#: Smallest height of a triangle [m]. Rounded coordinates in a file would turn the normal of a flatter triangle.
MIN_HEIGHT_M = 1e-7
#: Distance from a triangle's plane below which a corner is in this plane [m].
TOUCH_M = 1e-9
#: Smallest mean thickness of a body [m]; a flatter one has no inside.
MIN_THICKNESS_M = 1e-5
#: Bounds of the distance from a triangle at which its sides are checked [m], and this distance over its height.
SIDE_M, SIDE_SHARE = (2e-9, 1e-7), 0.01
#: Directions of rays. They are parallel to no edge of usual shapes; if a ray meets an edge, the next one is used.
RAYS = np.array([(0.5377, 0.1834, -0.8236), (-0.3188, 0.9077, 0.2727), (0.2343, -0.6180, 0.7505)])
#: Packed `Region` of a mesh without margin.
_PACKED = np.array([4.0, 1.0, *[0.0] * 16])


class ClosedSurface(NamedTuple):
    """A mesh whose winding number is 0 outside and 1 inside."""

    mesh: Mesh
    turned: int  #: number of triangles that did not face outward before


def closed_surface(triangles: Array) -> ClosedSurface:
    """Return the mesh of closed bodies from triangles (t, 3, 3) in any winding [m].

    Raises:
        DescriptionError: size or number of the triangles is out of range; or the surface has a hole, only one side, a
            flat body or triangle, or bodies that touch, overlap or contain each other.
    """
    check_triangles(triangles)
    _, first, indices = np.unique(
        np.rint(triangles.reshape(-1, 3) / SAME_CORNER_M).astype(np.int64), axis=0, return_index=True,
        return_inverse=True,
    )  # fmt: skip
    corners, faces = triangles.reshape(-1, 3)[first], indices.reshape(-1, 3)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # without triangles that are a line or a point
    if not len(faces):
        raise DescriptionError("all triangles are smaller than 0.001 mm; is the unit right?")
    outward, bodies = _wound_alike(corners, faces)
    volumes, areas = _volumes(corners[outward], bodies)
    thickness = 2.0 * np.abs(volumes) / areas
    flat = int(thickness.argmin())
    if thickness[flat] < MIN_THICKNESS_M:
        raise DescriptionError(
            f"the body near {_place(corners[outward[bodies == flat]].mean(axis=(0, 1)))} is flat: its mean thickness is"
            f" {1e3 * thickness[flat]:.2g} mm, required: {1e3 * MIN_THICKNESS_M:g} mm; remove it, or give it a volume"
        )
    inverted = (volumes < 0.0)[bodies]
    outward[inverted] = outward[inverted][:, ::-1]
    found = mesh(corners[outward])
    heights = _heights(found.triangles)
    if heights.min() < MIN_HEIGHT_M:
        raise DescriptionError(
            f"the triangle near {_place(found.triangles[heights.argmin()].mean(axis=0))} is a line: its height is"
            f" {1e3 * heights.min():.2g} mm, required: {1e3 * MIN_HEIGHT_M:g} mm; remesh the surface, for example in"
            " MeshLab"
        )
    keys, where = np.unique(_edge_keys(_directed_edges(outward), len(corners))), np.empty(3)
    if _pierced(found, corners[np.column_stack(np.divmod(keys, len(corners)))], where):
        raise DescriptionError(
            f"the surface passes through itself near {_place(where)}; unite its bodies, for example with the Boolean"
            " union of MeshLab or Blender, or write a region for each"
        )
    wrong = _wrong_side(found, np.clip(SIDE_SHARE * heights, *SIDE_M), _PACKED, RAYS)
    if wrong >= 0:
        raise DescriptionError(
            f"bodies touch, coincide or contain each other near {_place(found.triangles[wrong].mean(axis=0))}: unite"
            " them or remove the inner one, for example in MeshLab, or write a region for each"
        )
    return ClosedSurface(found, int((outward != faces).any(axis=1).sum()))


def _place(point: Array) -> str:
    return f"({', '.join(f'{1e3 * x:.4g}' for x in point)}) mm"


def _directed_edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the corners (3 t, 2) of the edges of faces (t, 3), in the direction of the face."""
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def _edge_keys(directed: NDArray[np.int64], corners: int) -> NDArray[np.int64]:
    """Return a number for each edge (e, 2), which is the same for both directions."""
    return directed.min(axis=1) * corners + directed.max(axis=1)


def _wound_alike(corners: Array, faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the faces (t, 3), wound alike in each body, and the body of each face (t,).

    Each face has two windings. Two neighbours are wound alike if they pass their common edge in opposite directions.
    This relation divides the windings of a body into two sets, and either of them is a consistent surface.
    """
    from scipy.sparse import coo_array  # pyright: ignore  - slow to import
    from scipy.sparse.csgraph import connected_components  # pyright: ignore  - slow to import

    count = len(faces)
    directed = _directed_edges(faces)
    _, edge, used = np.unique(_edge_keys(directed, len(corners)), return_inverse=True, return_counts=True)
    if (used != 2).any():
        wrong = int(np.abs(used - 2).argmax())
        near = _place(corners[directed[edge == wrong][0]].mean(axis=0))
        if used.min() < 2 and used.max() <= 2:
            raise DescriptionError(
                f"the surface is not closed: {int((used == 1).sum())} edges belong to one triangle, for example near"
                f" {near}; repair its holes, for example in MeshLab"
            )
        raise DescriptionError(
            f"the surface is not closed or touches itself: {int((used != 2).sum())} edges do not belong to two"
            f" triangles, for example near {near}; separate or unite its bodies, for example in MeshLab"
        )
    order = np.argsort(edge, kind="stable")
    one, other = order[::2], order[1::2]
    first, second = one // 3, other // 3
    opposite = directed[one, 0] == directed[other, 1]
    partner = np.where(opposite, second, second + count)  # winding of face `second` that fits the given one of `first`
    mirrored = np.where(opposite, second + count, second)
    rows, columns = np.concatenate((first, first + count)), np.concatenate((partner, mirrored))
    links = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    label: NDArray[np.int32] = np.asarray(connected_components(links, directed=False)[1], np.int32)  # pyright: ignore
    if (label[:count] == label[count:]).any():
        raise DescriptionError(
            "the surface has only one side, so it encloses nothing; remesh it, for example in MeshLab"
        )
    _, bodies = np.unique(np.minimum(label[:count], label[count:]), return_inverse=True)
    found = faces.copy()
    turned = label[:count] > label[count:]
    found[turned] = found[turned][:, ::-1]
    return found, bodies


def _volumes(triangles: Array, bodies: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return volume [m^3] and area [m^2] of each body; the volume is negative if the triangles face inward."""
    count = int(bodies.max()) + 1
    first = np.zeros(count, np.int64)
    first[bodies[::-1]] = np.arange(len(bodies))[::-1]
    a, b, c = np.moveaxis(triangles - triangles[first[bodies], :1], 1, 0)
    crosses = np.cross(b - a, c - a)
    volumes: Array = np.bincount(bodies, np.sum(a * np.cross(b, c), axis=1) / 6.0, count).astype(float)
    areas: Array = np.bincount(bodies, 0.5 * np.linalg.norm(crosses, axis=1), count).astype(float)
    return volumes, areas


def _heights(triangles: Array) -> Array:
    """Return the smallest height of each triangle (t,) [m]."""
    sides = triangles - np.roll(triangles, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / longest


@compiled
def _crossing(surface: Mesh, t: int, start: Array, ray: Array) -> float:
    """Return where a ray crosses triangle number t, in lengths of `ray`; -1 if it does not (Moeller 1997)."""
    corner, ab, ac, off = surface.triangles[t, 0], np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        ab[k], ac[k] = surface.triangles[t, 1, k] - corner[k], surface.triangles[t, 2, k] - corner[k]
        off[k] = start[k] - corner[k]
    p0, p1, p2 = ray[1] * ac[2] - ray[2] * ac[1], ray[2] * ac[0] - ray[0] * ac[2], ray[0] * ac[1] - ray[1] * ac[0]
    determinant = ab[0] * p0 + ab[1] * p1 + ab[2] * p2
    if determinant == 0.0:
        return -1.0
    u = (off[0] * p0 + off[1] * p1 + off[2] * p2) / determinant
    q0, q1, q2 = off[1] * ab[2] - off[2] * ab[1], off[2] * ab[0] - off[0] * ab[2], off[0] * ab[1] - off[1] * ab[0]
    v = (ray[0] * q0 + ray[1] * q1 + ray[2] * q2) / determinant
    if u < 0.0 or v < 0.0 or u + v > 1.0:
        return -1.0
    return (ac[0] * q0 + ac[1] * q1 + ac[2] * q2) / determinant


@compiled
def _meets(boxes: Array, box: int, start: Array, ray: Array, longest: float) -> bool:
    """Return whether a ray from `start` meets a box within `longest` times its length."""
    near, far = 0.0, longest
    for k in range(3):
        low, high = boxes[box, k] - start[k], boxes[box, 3 + k] - start[k]
        if ray[k] == 0.0:
            if low > 0.0 or high < 0.0:
                return False
            continue
        low, high = low / ray[k], high / ray[k]
        near, far = max(near, min(low, high)), min(far, max(low, high))
    return near <= far * (1.0 + 1e-12)


@compiled
def winding_number(surface: Mesh, point: Array, ray: Array) -> int:
    """Return the winding number of a closed surface about a point (3,), by a ray (3,) from it."""
    waiting, count, number = np.empty(MAX_WAITING, np.int64), 1, 0
    waiting[0] = 0
    while count > 0:
        count -= 1
        box = waiting[count]
        if not _meets(surface.boxes, box, point, ray, np.inf):
            continue
        first, size = surface.contents[box, 0], surface.contents[box, 1]
        if size == 0:
            waiting[count], waiting[count + 1] = box + 1, first
            count += 2
        for t in range(first, first + size):
            if _crossing(surface, t, point, ray) > 0.0:
                along = 0.0
                for k in range(3):
                    along += surface.normals[t, k] * ray[k]
                number += 1 if along > 0.0 else -1
    return number


@compiled
def _pierced(surface: Mesh, edges: Array, where: Array) -> bool:
    """Return whether an edge (e, 2, 3) passes through a triangle to which it does not belong; write the point."""
    waiting, ray = np.empty(MAX_WAITING, np.int64), np.empty(3)
    for e in range(edges.shape[0]):
        start, count = edges[e, 0], 1
        for k in range(3):
            ray[k] = edges[e, 1, k] - start[k]
        waiting[0] = 0
        while count > 0:
            count -= 1
            box = waiting[count]
            if not _meets(surface.boxes, box, start, ray, 1.0):
                continue
            first, size = surface.contents[box, 0], surface.contents[box, 1]
            if size == 0:
                waiting[count], waiting[count + 1] = box + 1, first
                count += 2
            for t in range(first, first + size):
                before, after = 0.0, 0.0
                for k in range(3):
                    before += surface.normals[t, k] * (start[k] - surface.triangles[t, 0, k])
                    after += surface.normals[t, k] * (edges[e, 1, k] - surface.triangles[t, 0, k])
                if min(before, after) > -TOUCH_M or max(before, after) < TOUCH_M:
                    continue  # on one side, or in the triangle's plane
                if _has_corner(surface, t, start) or _has_corner(surface, t, edges[e, 1]):
                    continue
                at = _crossing(surface, t, start, ray)
                if 0.0 <= at <= 1.0:
                    for k in range(3):
                        where[k] = start[k] + at * ray[k]
                    return True
    return False


@compiled
def _has_corner(surface: Mesh, t: int, point: Array) -> bool:
    """Return whether a point is a corner of triangle number t."""
    for i in range(3):
        corner = surface.triangles[t, i]
        if corner[0] == point[0] and corner[1] == point[1] and corner[2] == point[2]:
            return True
    return False


@compiled
def _wrong_side(surface: Mesh, distances: Array, packed: Array, rays: Array) -> int:
    """Return the index of a triangle with a wrong winding number or sign of the distance at a side; -1: none."""
    point, direction = np.empty(3), np.empty(3)
    for t in range(surface.triangles.shape[0]):
        for inside in range(2):
            away = distances[t] if inside == 0 else -distances[t]
            for k in range(3):
                centre = (surface.triangles[t, 0, k] + surface.triangles[t, 1, k] + surface.triangles[t, 2, k]) / 3.0
                point[k] = centre + away * surface.normals[t, k]
            right = False
            for r in range(rays.shape[0]):
                right = right or winding_number(surface, point, rays[r]) == inside
            if not right or signed_distance(packed, surface, point, direction) * away <= 0.0:
                return t
    return -1
