"""The drawn surface of a region is where the limit of the controller has the distance zero."""

import numpy as np
import pytest
import trimesh

from core.robot.regions import Region, mesh
from web.scene.regions import surface

TURN = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0))[:3, :3]
BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.02)


@pytest.mark.parametrize("region", [
    Region("ball", "sphere", (0.01, 0.02, 0.1, 0.02)),
    Region("rib", "capsule", (0.018, -0.04, 0.1285, 0.018, 0.01, 0.13, 0.004)),
    Region("box", "box", (0.01, 0.02, 0.1, 0.015, 0.005, 0.010, *TURN.ravel())),
    Region("body", "mesh", (), mesh=mesh(np.asarray(BALL.triangles))),
    Region("table", "half_space", (0.08, 0.0, 0.1, -0.6, 0.0, 0.8)),
], ids=lambda region: region.kind)  # fmt: skip
def test_corners_of_the_drawn_surface_have_no_distance_to_the_region(region: Region) -> None:
    corners, faces = surface(region)
    assert faces.max() < len(corners)
    assert max(abs(region.distance(corner)[0]) for corner in corners) < 1e-4
