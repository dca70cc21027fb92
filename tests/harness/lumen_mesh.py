"""Closed mesh of a lumen: a bent tube with round cross-sections, whose radius may change along its axis."""

from pathlib import Path

import numpy as np
import trimesh

from core.robot.robot import Array

#: Corners of each ring.
CORNERS = 24


def lumen(axis: Array, radii: Array) -> trimesh.Trimesh:
    """Return the mesh of a lumen around an axis of points (k, 3) [m] with radii (k,) [m]; flat ends close it."""
    tangents = np.gradient(axis, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.cross(tangents[0], (1.0, 0.0, 0.0) if abs(tangents[0, 0]) < 0.9 else (0.0, 1.0, 0.0))
    corners: list[Array] = []
    for point, tangent, radius in zip(axis, tangents, radii, strict=True):
        across = across - (across @ tangent) * tangent
        across /= np.linalg.norm(across)
        angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)[:, None]
        corners.append(point + radius * (np.cos(angles) * across + np.sin(angles) * np.cross(tangent, across)))
    first, last = len(axis) * CORNERS, len(axis) * CORNERS + 1
    faces: list[tuple[int, int, int]] = []
    for j in range(CORNERS):
        k = (j + 1) % CORNERS
        for ring in range(0, (len(axis) - 1) * CORNERS, CORNERS):
            after = ring + CORNERS
            faces += [(ring + j, ring + k, after + j), (ring + k, after + k, after + j)]
        end = (len(axis) - 1) * CORNERS
        faces += [(first, k, j), (last, end + j, end + k)]
    return trimesh.Trimesh(np.vstack((*corners, axis[0], axis[-1])), np.array(faces), process=False)


def write_lumen(file: Path, axis: Array, radii: Array) -> None:
    """Write the lumen to an STL file, in millimetres."""
    lumen(1e3 * axis, 1e3 * radii).export(file)
