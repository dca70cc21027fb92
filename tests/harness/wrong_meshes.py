"""Random meshes with the faults of real files: turned triangles, nested or overlapping bodies, wrong units, holes."""

from typing import NamedTuple

import numpy as np
import trimesh

from core.robot.robot import Array

FAULTS = (
    "none", "inside out", "turned", "turned in each body", "nested", "nested cavity", "overlapping", "touching",
    "twice", "hole", "flat", "sheared corner", "collapsed triangle", "split edge", "metres", "micrometres", "1e-15",
    "1e-300", "1e300", "nan", "infinite", "far away", "speck", "folded",
)  # fmt: skip


class RandomMesh(NamedTuple):
    """Triangles in metres."""

    fault: str
    triangles: Array  #: (t, 3, 3)


def body(random: np.random.Generator, size: float) -> Array:
    """Return the outward triangles (t, 3, 3) of a random body around the origin, of about a size [m]."""
    kind = int(random.integers(6))
    found = (
        lambda: trimesh.creation.box(random.uniform(0.3, 1.0, 3)),
        lambda: trimesh.creation.icosphere(subdivisions=int(random.integers(0, 3)), radius=0.5),
        lambda: trimesh.creation.capsule(height=0.5, radius=0.25, count=(6, 6)),
        lambda: trimesh.creation.torus(0.4, 0.1, major_sections=12, minor_sections=6),
        lambda: trimesh.creation.annulus(r_min=0.2, r_max=0.5, height=0.4, sections=12),
        lambda: trimesh.creation.cylinder(radius=0.3, height=0.8, sections=16),
    )[kind]()
    found.apply_transform(trimesh.transformations.random_rotation_matrix(random.random(3)))
    return size * np.asarray(found.triangles)


def random_mesh(seed: int, fault: str = "") -> RandomMesh:
    """Return one to three separate bodies with a fault; an empty fault is a random one."""
    random = np.random.default_rng(seed)
    fault = fault or str(random.choice(FAULTS))
    size = float(random.uniform(0.005, 0.05))
    bodies = [body(random, size)]
    others = int(random.integers(0, 3))
    bodies += [body(random, size) + np.array([1.6 * size * (number + 1), 0.0, 0.0]) for number in range(others)]
    first, centre = bodies[0], bodies[0].mean(axis=(0, 1))
    pick = int(random.integers(len(first)))
    if fault == "inside out":
        bodies[0] = first[:, ::-1]
    elif fault == "turned":
        first[pick] = first[pick, ::-1]
    elif fault == "turned in each body":
        for one in bodies:
            some = random.random(len(one)) < random.uniform(0.05, 0.6)
            one[some] = one[some][:, ::-1]
    elif fault in ("nested", "nested cavity"):
        box = 0.05 * size * np.asarray(trimesh.creation.box((1.0, 1.0, 1.0)).triangles)
        inner = box + np.mean(first[pick], axis=0) + 0.1 * size * _inward(first[pick])
        bodies.append(inner[:, ::-1] if fault == "nested cavity" else inner)
    elif fault == "overlapping":
        bodies.append(body(random, size) + random.uniform(-0.3, 0.3, 3) * size)
    elif fault == "touching":
        bodies.append(first * (1.0, 1.0, -1.0) + (0.0, 0.0, 2.0 * first[..., 2].max()))
        bodies[-1] = bodies[-1][:, ::-1]
    elif fault == "twice":
        bodies.append(first[:, ::-1] if random.random() < 0.5 else first.copy())
    elif fault == "hole":
        bodies[0] = np.delete(first, pick, axis=0)
    elif fault == "flat":
        bodies[0] = first * (1.0, 1.0, 10.0 ** random.uniform(-12.0, -3.0))
    elif fault == "sheared corner":
        corner = first[pick, 0].copy()
        same = (np.abs(first - corner) < 1e-9).all(axis=2)
        first[same] = centre + random.uniform(-2.0, 2.0) * (corner - centre) + random.normal(0.0, 0.3 * size, 3)
    elif fault == "collapsed triangle":
        bodies.append(np.array([[first[pick, 0], first[pick, 0], first[pick, 1]]]))
    elif fault == "split edge":  # a corner on an edge: one triangle becomes two and a line
        a, b, c = first[pick]
        middle = 0.5 * (a + b) + random.normal(0.0, 10.0 ** random.uniform(-12.0, -6.0), 3)
        bodies[0] = np.concatenate((np.delete(first, pick, axis=0), [[a, middle, c], [middle, b, c], [a, b, middle]]))
    elif fault == "speck":
        bodies.append(10.0 ** random.uniform(-9.0, -4.0) * first + (0.0, 0.0, 2.0 * size))
    elif fault == "folded":
        a, b, c = first[pick]
        bodies.append(np.array([[a, b, c], [c, b, a]]))
    triangles = np.concatenate(bodies)
    if fault in ("metres", "micrometres", "1e-15", "1e-300", "1e300"):
        factor = {"metres": 1e-3, "micrometres": 1e3}.get(fault)
        with np.errstate(over="ignore"):
            triangles = triangles * (float(fault) if factor is None else factor)
    elif fault == "nan":
        triangles[random.integers(len(triangles)), 0, 0] = np.nan
    elif fault == "infinite":
        triangles[random.integers(len(triangles)), 1, 2] = np.inf
    elif fault == "far away":
        triangles = triangles + 10.0 ** random.uniform(0.0, 20.0)
    return RandomMesh(fault, triangles)


def _inward(triangle: Array) -> Array:
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    return -normal / np.linalg.norm(normal)


def winding_numbers(triangles: Array, points: Array) -> Array:
    """Return the winding number of triangles about points (k, 3), from solid angles (van Oosterom, Strackee 1983)."""
    a, b, c = (triangles[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=2) for one in (a, b, c))
    dots = np.sum(a * b, axis=2) * lc + np.sum(b * c, axis=2) * la + np.sum(c * a, axis=2) * lb
    return np.sum(2.0 * np.arctan2(np.sum(a * np.cross(b, c), axis=2), la * lb * lc + dots), axis=1) / (4.0 * np.pi)
