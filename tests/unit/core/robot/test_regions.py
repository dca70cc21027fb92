"""Distances to regions against closed forms and against brute force over triangles."""

import numpy as np
import pytest
import trimesh

from core.errors import DescriptionError
from core.robot.regions import Region, mesh
from core.robot.robot import Array
from tests.harness.wrong_meshes import winding_numbers

TURN = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0))
RNG = np.random.default_rng(5)


def brute_force(triangles: Array, point: Array) -> float:
    """Return the signed distance of a point to closed triangles, negative inside."""
    nearest = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
    distance = float(np.linalg.norm(nearest - point, axis=1).min())
    return distance if winding_numbers(triangles, point[None])[0] < 0.5 else -distance


@pytest.mark.parametrize("body", [
    trimesh.creation.icosphere(subdivisions=2, radius=0.02),
    trimesh.creation.annulus(r_min=0.006, r_max=0.015, height=0.02, sections=24),  # concave, with sharp edges
    trimesh.creation.cylinder(radius=0.01, height=0.04, sections=90),  # long, narrow triangles
])  # fmt: skip
def test_distance_to_a_mesh_equals_brute_force(body: trimesh.Trimesh) -> None:
    triangles = np.asarray(body.copy().apply_transform(TURN).triangles)
    region = Region("body", "mesh", (), mesh=mesh(triangles))
    for point in RNG.uniform(-0.025, 0.025, (80, 3)):
        assert region.distance(point)[0] == pytest.approx(brute_force(triangles, point), abs=1e-12)


def test_distance_to_a_box_equals_that_of_its_mesh_and_its_direction_is_its_gradient() -> None:
    numbers = (0.0, 0.0, 0.0, 0.015, 0.005, 0.010, *TURN[:3, :3].ravel())
    box = Region("box", "box", numbers)
    triangles = np.asarray(trimesh.creation.box((0.03, 0.01, 0.02)).apply_transform(TURN).triangles)
    for point in RNG.uniform(-0.02, 0.02, (80, 3)):
        distance, direction = box.distance(point)
        assert distance == pytest.approx(brute_force(triangles, point), abs=1e-12)
        assert box.distance(point + 1e-7 * direction)[0] - distance == pytest.approx(1e-7, rel=1e-3)


@pytest.mark.parametrize(("region", "point", "distance"), [
    (Region("sphere", "sphere", (0.0, 0.0, 0.1, 0.02)), (0.03, 0.0, 0.1), 0.01),
    (Region("rib", "capsule", (0.0, -0.05, 0.1, 0.0, 0.05, 0.1, 0.004)), (0.01, 0.02, 0.1), 0.006),
    (Region("rib", "capsule", (0.0, -0.05, 0.1, 0.0, 0.05, 0.1, 0.004)), (0.0, 0.06, 0.1), 0.006),
    (Region("table", "half_space", (0.05, 0.0, 0.0, -1.0, 0.0, 0.0)), (0.02, 0.3, 0.1), 0.03),
])  # fmt: skip
def test_distance_to_a_simple_region(region: Region, point: tuple[float, ...], distance: float) -> None:
    assert region.distance(np.array(point))[0] == pytest.approx(distance, abs=1e-12)


def test_a_mesh_in_a_wrong_unit_is_refused() -> None:
    body = trimesh.creation.icosphere(subdivisions=1, radius=20.0)  # millimetres read as metres
    with pytest.raises(DescriptionError, match="is its unit right"):
        mesh(np.asarray(body.triangles))
