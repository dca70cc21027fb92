"""Regions that the tubes must not enter or leave, and the nearest pair of points of a region and the tubes."""

from collections.abc import Sequence

import numpy as np
import viser

from core.robot.keep_out import KeepOut, smallest_clearance
from core.robot.limits import Backbone, Limit
from core.robot.regions import Region
from core.robot.robot import Array, Indices
from station.config import palette

#: Clearance at which the line to the nearest region appears, and below which it has the colour of a warning [m].
SHOW_CLEARANCE_M, NEAR_CLEARANCE_M = 0.02, 0.002
#: Half of the drawn part of a plane [m].
PLANE_M = 0.15
OPACITY_OUTSIDE, OPACITY_INSIDE = 0.35, 0.12


class RegionMarks:
    """The regions, drawn once, and the line to the nearest one."""

    def __init__(self, scene: viser.SceneApi, limits: Sequence[Limit], unit: float) -> None:
        self._limits = limits
        for number, limit in enumerate(one for one in limits if isinstance(one, KeepOut)):
            corners, faces = surface(limit.region)
            scene.add_mesh_simple(
                f"/regions/{number}", (unit * corners).astype(np.float32), faces, color=palette.SLATE, side="double",
                opacity=OPACITY_INSIDE if limit.region.inside else OPACITY_OUTSIDE, cast_shadow=False,
            )  # fmt: skip
        self._line = scene.add_line_segments(
            "/regions/nearest", np.zeros((1, 2, 3)), palette.SLATE, thickness=2.5, thickness_units="screen", scale=unit,
            visible=False,
        )  # fmt: skip

    @property
    def any(self) -> bool:
        """Whether there are regions."""
        return any(isinstance(one, KeepOut) for one in self._limits)

    def draw(self, near: Backbone | None) -> None:
        """Draw the line between the tubes and the nearest region; None: the tubes are not known."""
        found = None if near is None else smallest_clearance(self._limits, near)
        self._line.visible = found is not None and found[1].distance < SHOW_CLEARANCE_M
        if found is not None and self._line.visible:
            clearance = found[1]
            colour = palette.VERMILLION if clearance.distance < NEAR_CLEARANCE_M else palette.SLATE
            self._line.colors = np.tile(np.array(colour, np.uint8), (1, 2, 1))
            self._line.points = np.array([[clearance.point, clearance.nearest]], np.float32)


def surface(region: Region) -> tuple[Array, Indices]:
    """Return corners (v, 3) [m] and triangles (f, 3) of the drawn surface of a region."""
    import trimesh  # its import takes a second, and most stations have no regions

    numbers = np.array(region.numbers)
    if region.kind == "mesh":
        triangles = region.mesh.triangles
        return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    if region.kind == "sphere":
        body = trimesh.creation.icosphere(subdivisions=3, radius=region.numbers[3])
        body.apply_translation(numbers[:3])
    elif region.kind == "box":
        body = trimesh.creation.box(2.0 * numbers[3:6])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = numbers[6:15].reshape(3, 3), numbers[:3]
        body.apply_transform(pose)
    elif region.kind == "capsule":
        body = trimesh.creation.capsule(float(np.linalg.norm(numbers[3:6] - numbers[:3])), region.numbers[6])
        body.apply_transform(_along(0.5 * (numbers[:3] + numbers[3:6]), numbers[3:6] - numbers[:3] + (0.0, 0.0, 1e-12)))
    else:
        body = trimesh.creation.box((2.0 * PLANE_M, 2.0 * PLANE_M, 1e-4))
        body.apply_transform(_along(numbers[:3], numbers[3:6]))
    return np.asarray(body.vertices, np.float64), np.asarray(body.faces)


def _along(position: Array, direction: Array) -> Array:
    """Return the transform (4, 4) of the origin to a position, and of the z axis to a direction."""
    from trimesh.geometry import align_vectors

    turn = np.array(align_vectors((0.0, 0.0, 1.0), direction), np.float64)
    turn[:3, 3] = position
    return turn
