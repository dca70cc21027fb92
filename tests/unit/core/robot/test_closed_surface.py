"""The sign of the distance to an accepted mesh agrees with its winding number; other meshes are refused with advice."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import DescriptionError
from core.robot.closed_surface import RAYS, closed_surface, winding_number
from core.robot.regions import Region, mesh
from core.robot.robot import Array
from tests.harness.wrong_meshes import random_mesh, winding_numbers

#: Faults that can be repaired, because only one result is possible.
REPAIRED = ("inside out", "turned", "turned in each body", "collapsed triangle")
REFUSED = ("nested", "nested cavity", "overlapping", "twice", "hole", "folded",
           "1e-15", "1e-300", "1e300", "nan", "infinite")  # fmt: skip


def box(size: float, *centre: float) -> Array:
    """Return the outward triangles of a cube [mm] in metres."""
    return 1e-3 * (np.asarray(trimesh.creation.box((size,) * 3).triangles) + np.array(centre))


def assert_sign_is_right(triangles: Array) -> None:
    """Compare the signs of the distance with winding numbers from solid angles, at both sides of each triangle."""
    region, corners = Region("body", "mesh", (), mesh=mesh(triangles)), triangles.reshape(-1, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sides = triangles - np.roll(triangles, 1, axis=1)
    heights = np.linalg.norm(normals, axis=1) / np.linalg.norm(sides, axis=2).max(axis=1)
    away = np.minimum(1e-6, 0.02 * heights)[:, None] * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    centres = triangles.mean(axis=1)
    random = np.random.default_rng(0)
    around = random.uniform(corners.min(axis=0) - 0.01, corners.max(axis=0) + 0.01, (100, 3))
    for points, expected in ((centres + away, 0.0), (centres - away, 1.0), (around, None)):
        windings = winding_numbers(triangles, points)
        assert windings == pytest.approx(np.rint(windings), abs=1e-6)
        assert set(np.rint(windings)) <= ({0.0, 1.0} if expected is None else {expected})
        distances = [region.distance(point)[0] for point in points]
        assert (np.array(distances) < 0.0).tolist() == (windings > 0.5).tolist()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_an_accepted_mesh_has_the_sign_of_its_winding_number_and_a_refusal_has_one_line(seed: int) -> None:
    made, refusal, triangles = random_mesh(seed), "", np.empty((0, 3, 3))
    try:
        triangles = closed_surface(made.triangles).mesh.triangles
    except DescriptionError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert len(refusal) < 400
    if refusal:
        assert made.fault not in ("none", *REPAIRED)
    else:
        assert made.fault not in REFUSED
        assert_sign_is_right(triangles)


def test_the_sign_is_right_at_a_sharp_corner() -> None:
    """The triangle whose plane is farthest from a point has the wrong side of some points in front of a spike."""
    assert_sign_is_right(closed_surface(random_mesh(131).triangles).mesh.triangles)


@pytest.mark.parametrize("fault", REPAIRED)
def test_a_repairable_mesh_is_turned_outward(fault: str) -> None:
    for seed in range(2):
        assert_sign_is_right(closed_surface(random_mesh(seed, fault).triangles).mesh.triangles)


@pytest.mark.parametrize("turned", [[0], [3, 7], list(range(12))])
def test_turned_triangles_are_counted(turned: list[int]) -> None:
    triangles = np.concatenate((box(10.0, 0.0, 0.0, 0.0), box(8.0, 20.0, 0.0, 0.0)))
    right = closed_surface(triangles)
    assert right.turned == 0
    triangles[turned] = triangles[turned][:, ::-1]
    found = closed_surface(triangles)
    assert found.turned == len(turned)
    assert_sign_is_right(found.mesh.triangles)


CUBE = box(10.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("triangles", "reason"), [
    (np.concatenate((CUBE, box(4.0, 0.0, 0.0, 0.0))), "contain each other near .* remove the inner one"),
    (np.concatenate((CUBE, box(4.0, 0.0, 0.0, 0.0)[:, ::-1])), "contain each other near .* remove the inner one"),
    (np.concatenate((CUBE, box(10.0, 8.0, 8.5, 9.0))), "passes through itself near .* unite its bodies"),
    (np.concatenate((CUBE, box(10.0, 10.0, 0.0, 0.0))), "touches itself: 4 edges .* unite its bodies"),
    (np.concatenate((CUBE, CUBE)), "touches itself: 18 edges"),
    (CUBE[1:], r"not closed: 3 edges belong to one triangle.* repair its holes"),
    (CUBE * (1.0, 1.0, 1e-6), "is flat: its mean thickness"),
    (1e-3 * CUBE, "0.01 x 0.01 x 0.01 mm is too small .* is its unit right"),
    (1e-300 * CUBE, "too small"),
    (1e3 * CUBE, "1e\\+04 x 1e\\+04 x 1e\\+04 mm is too large"),
    (1e300 * CUBE, "1e\\+301 x 1e\\+301 x 1e\\+301 mm is too large"),
    (CUBE + 1e6, "move it near the origin"),
    (np.nan * CUBE, "not finite"),
    (np.zeros((4, 3, 3)), "0 x 0 x 0 mm is too small"),
    (np.empty((0, 3, 3)), "0 triangles"),
])  # fmt: skip
def test_a_mesh_whose_shape_is_unknown_is_refused_with_advice(triangles: Array, reason: str) -> None:
    with pytest.raises(DescriptionError, match=reason):
        closed_surface(triangles)


def test_a_surface_with_one_side_is_refused() -> None:
    """Two corners of a grid on a Klein bottle are joined in reverse."""
    n = 12
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    a, b = 2.0 * np.pi * u / n, 2.0 * np.pi * (v + 0.5) / n
    ring = 3.0 + np.cos(0.5 * a) * np.sin(b) - np.sin(0.5 * a) * np.sin(2.0 * b)
    points = 0.01 * np.stack(
        (ring * np.cos(a), ring * np.sin(a), np.sin(0.5 * a) * np.sin(b) + np.cos(0.5 * a) * np.sin(2.0 * b)), axis=2
    )

    def corner(i: int, j: int) -> Array:
        return points[i, j % n] if i < n else points[0, (-j - 1) % n]

    faces: list[tuple[Array, Array, Array]] = []
    for i in range(n):
        for j in range(n):
            faces.append((corner(i, j), corner(i + 1, j), corner(i, j + 1)))
            faces.append((corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)))
    with pytest.raises(DescriptionError, match="only one side"):
        closed_surface(np.array(faces))


def test_the_winding_number_by_a_ray_is_that_by_solid_angles() -> None:
    nested = np.concatenate((CUBE, box(4.0, 0.0, 0.0, 0.0), box(4.0, 20.0, 0.0, 0.0)[:, ::-1]))
    points = np.random.default_rng(1).uniform(-0.006, 0.024, (200, 3)) * (1.0, 0.4, 0.4)
    found = [winding_number(mesh(nested), point, RAYS[0]) for point in points]
    assert found == np.rint(winding_numbers(nested, points)).astype(int).tolist()
    assert set(found) == {-1, 0, 1, 2}
