"""Geometry of the drawn tubes, against shapes that are known otherwise."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from core.model.statics import Statics
from core.robot.robot import Array, Robot, Section, Tube
from web.scene.tubes import TubeMesh, centre_line

RADIUS = 0.25  # of the arc [m]
POSES = [
    ((0.0, 1.57, -0.1), (0.5, 0.0, 0.0)),
    ((1.0, -2.0, -0.02), (0.0, 0.3, -0.2)),
    ((-2.0, 0.3, -0.13), (0.0, 0.0, 0.0)),
]


def arc(at: Array) -> tuple[Array, Array]:
    """Positions and tangents of a circular arc that starts along +z and bends toward -y."""
    angle = at / RADIUS
    nothing = np.zeros_like(at)
    place = np.stack((nothing, RADIUS * (np.cos(angle) - 1.0), RADIUS * np.sin(angle)), axis=1)
    return place, np.stack((nothing, -np.sin(angle), np.cos(angle)), axis=1)


def arc_shape() -> Array:
    """The arc as the model would give it, a cross-section every 10 mm and one of them twice."""
    at = np.sort(np.append(np.linspace(0.0, 0.2, 21), 0.1))
    place, tangent = arc(at)
    x = np.tile([1.0, 0.0, 0.0], (len(at), 1))
    frame = np.stack((x, np.cross(tangent, x), tangent), axis=2)
    return np.concatenate((at[:, None], frame.reshape(-1, 9), place), axis=1)


def test_the_centre_line_follows_the_arc_between_cross_sections() -> None:
    at = np.linspace(0.0, 0.2, 333)
    place, frame = centre_line(arc_shape(), at)
    true_place, true_tangent = arc(at)
    np.testing.assert_allclose(place, true_place, atol=1e-8)
    np.testing.assert_allclose(frame[:, :, 2], true_tangent, atol=1e-5)


def test_frames_are_right_handed_and_square() -> None:
    _, frame = centre_line(arc_shape(), np.linspace(-0.1, 0.2, 50))
    np.testing.assert_allclose(np.einsum("kij,kil->kjl", frame, frame), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0)


def test_behind_the_plate_the_line_is_straight() -> None:
    place, frame = centre_line(arc_shape(), np.array([-0.1, -0.03]))
    np.testing.assert_allclose(place, [[0.0, 0.0, -0.1], [0.0, 0.0, -0.03]], atol=1e-15)
    np.testing.assert_allclose(frame[:, :, 2], [[0.0, 0.0, 1.0]] * 2)


@pytest.mark.parametrize(("joints", "force"), POSES)
def test_every_ring_has_the_tubes_radius(
    paper_robot: Robot, joints: tuple[float, ...], force: tuple[float, ...]
) -> None:
    # The finely cut shape of the same model stands for the true centre line; the mesh sees a coarse one.
    statics = Statics(paper_robot, sublink=0.0002)
    solution = statics.solve(np.array(joints), np.array([*force, 0.0, 0.0, 0.0]))
    fine = statics.shape(solution)
    coarse = np.concatenate((fine[:-1:50], fine[-1:]))
    _, beta = paper_robot.tube_poses(solution.joints)
    behind = np.linspace(-0.14, 0.0, 1000)
    line = cKDTree(np.concatenate((np.outer(behind, [0.0, 0.0, 1.0]), fine[:, 10:13])))
    for tube, start in zip(paper_robot.tubes, beta, strict=True):
        mesh = TubeMesh(tube, rings=60, sides=12)
        rings = mesh.vertices(coarse, float(start))[: 60 * 12]
        distance, _ = line.query(rings)
        np.testing.assert_allclose(distance, 0.5 * tube.outer_diameter, atol=1.2e-5)


@pytest.mark.parametrize(("joints", "force"), POSES)
def test_a_tube_reaches_from_its_proximal_to_its_far_end(
    paper_robot: Robot, joints: tuple[float, ...], force: tuple[float, ...]
) -> None:
    statics = Statics(paper_robot)
    solution = statics.solve(np.array(joints), np.array([*force, 0.0, 0.0, 0.0]))
    shape = statics.shape(solution)
    ends = [
        TubeMesh(tube).vertices(shape, beta) for tube, beta in zip(paper_robot.tubes, (joints[2], 0.0), strict=True)
    ]
    inner, outer = ends
    first, last = -14, -1  # the centres of the ends stand after their rims
    np.testing.assert_allclose(inner[first], [0.0, 0.0, joints[2]], atol=1e-12)
    np.testing.assert_allclose(inner[last], solution.tip, atol=1e-12)
    np.testing.assert_allclose(outer[first], np.zeros(3), atol=1e-12)
    # The model has a cross-section where the outer tube ends, 165 mm from the plate.
    row = shape[np.argmin(np.abs(shape[:, 0] - 0.165))]
    np.testing.assert_allclose(outer[last], row[10:13], atol=1e-9)


def test_the_surface_is_closed_and_looks_outward() -> None:
    tube = Tube("arc", (Section(0.15),), 0.04, outer_diameter=2.4e-3, inner_diameter=1e-3)
    mesh = TubeMesh(tube, rings=60, sides=24)
    points = mesh.vertices(arc_shape(), 0.02)
    assert len(points) == mesh.count
    corners = points[mesh.faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    polygon = 0.5 * 24 * np.sin(2.0 * np.pi / 24) * 1.2e-3**2
    assert volume == pytest.approx(polygon * 0.15, rel=2e-3)
    # Every edge has its two sides, once the doubled rims are taken as one.
    _, same = np.unique(points.round(9), axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    assert edges == {(b, a) for a, b in edges}


def test_the_wider_tube_hides_the_narrower_one(paper_robot: Robot) -> None:
    inner, outer = paper_robot.tubes
    flat = np.cos(np.pi / 12)  # a ring of 12 points comes nearer between them
    assert flat * outer.outer_diameter > inner.outer_diameter
