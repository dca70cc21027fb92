"""Geometry of the drawn tubes, compared with analytic shapes."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Array, Robot, Section, Tube
from station.config.robots import load_robot
from web.scene.robot_mesh import Bend, TubeMesh, centre_line

RADIUS = 0.25  # radius of the arc [m]
POSES = [
    ((0.0, 1.57, -0.1), (0.5, 0.0, 0.0)),
    ((1.0, -2.0, -0.02), (0.0, 0.3, -0.2)),
    ((-2.0, 0.3, -0.13), (0.0, 0.0, 0.0)),
]


def arc(at: Array) -> tuple[Array, Array]:
    """Return positions and tangents of a circular arc that starts along +z and bends toward -y."""
    angle = at / RADIUS
    nothing = np.zeros_like(at)
    place = np.stack((nothing, RADIUS * (np.cos(angle) - 1.0), RADIUS * np.sin(angle)), axis=1)
    return place, np.stack((nothing, -np.sin(angle), np.cos(angle)), axis=1)


def arc_shape() -> Array:
    """Return the arc in the model's format: a cross-section every 10 mm, one of them twice."""
    at = np.sort(np.append(np.linspace(0.0, 0.2, 21), 0.1))
    place, tangent = arc(at)
    x = np.tile([1.0, 0.0, 0.0], (len(at), 1))
    frame = np.stack((x, np.cross(tangent, x), tangent), axis=2)
    return np.concatenate((at[:, None], frame.reshape(-1, 9), place), axis=1)


def test_the_drawn_centre_line_follows_the_arc_between_cross_sections() -> None:
    at = np.linspace(0.0, 0.2, 333)
    place, frame = centre_line(arc_shape(), at)
    true_place, true_tangent = arc(at)
    np.testing.assert_allclose(place, true_place, atol=1e-8)
    np.testing.assert_allclose(frame[:, :, 2], true_tangent, atol=1e-5)


def test_the_frames_along_a_drawn_tube_are_right_handed_and_orthogonal() -> None:
    _, frame = centre_line(arc_shape(), np.linspace(-0.1, 0.2, 50))
    np.testing.assert_allclose(np.einsum("kij,kil->kjl", frame, frame), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0)


def test_the_drawn_centre_line_is_straight_behind_the_plate() -> None:
    place, frame = centre_line(arc_shape(), np.array([-0.1, -0.03]))
    np.testing.assert_allclose(place, [[0.0, 0.0, -0.1], [0.0, 0.0, -0.03]], atol=1e-15)
    np.testing.assert_allclose(frame[:, :, 2], [[0.0, 0.0, 1.0]] * 2)


@pytest.mark.parametrize(("joints", "force"), POSES)
def test_every_ring_of_a_tube_mesh_has_the_tubes_radius(
    paper_robot: Robot, joints: tuple[float, ...], force: tuple[float, ...]
) -> None:
    # The reference centre line is the same model's shape with a fine step; the mesh gets a coarse one.
    statics = Statics(paper_robot, sublink=0.0002)
    solution = statics.solve(np.array(joints), np.array([*force, 0.0, 0.0, 0.0]))
    fine = statics.shape(solution)
    coarse = np.concatenate((fine[:-1:50], fine[-1:]))
    _, beta = paper_robot.tube_poses(solution.joints)
    behind = np.linspace(-0.14, 0.0, 1000)
    line = cKDTree(np.concatenate((np.outer(behind, [0.0, 0.0, 1.0]), fine[:, 10:13])))
    for tube, start in zip(paper_robot.tubes, beta, strict=True):
        mesh = TubeMesh(tube, rings=60, sides=12)
        rings = mesh.vertices(mesh.line(coarse, float(start)))[: 60 * 12]
        distance, _ = line.query(rings)
        np.testing.assert_allclose(distance, 0.5 * tube.outer_diameter, atol=1.2e-5)


@pytest.mark.parametrize(("joints", "force"), POSES)
def test_a_drawn_tube_extends_from_its_proximal_to_its_distal_end(
    paper_robot: Robot, joints: tuple[float, ...], force: tuple[float, ...]
) -> None:
    statics = Statics(paper_robot)
    solution = statics.solve(np.array(joints), np.array([*force, 0.0, 0.0, 0.0]))
    shape = statics.shape(solution)
    ends = [
        (mesh := TubeMesh(tube)).vertices(mesh.line(shape, beta))
        for tube, beta in zip(paper_robot.tubes, (joints[2], 0.0), strict=True)
    ]
    inner, outer = ends
    first, last = -14, -1  # indices of the centres of the two ends, each after its rim
    np.testing.assert_allclose(inner[first], [0.0, 0.0, joints[2]], atol=1e-12)
    np.testing.assert_allclose(inner[last], solution.tip, atol=1e-12)
    np.testing.assert_allclose(outer[first], np.zeros(3), atol=1e-12)
    # The model has a cross-section where the outer tube ends, 165 mm from the plate.
    row = shape[np.argmin(np.abs(shape[:, 0] - 0.165))]
    np.testing.assert_allclose(outer[last], row[10:13], atol=1e-9)


def test_the_surface_of_a_tube_mesh_is_closed_and_its_normals_point_outward() -> None:
    tube = Tube("arc", (Section(0.15),), 0.04, outer_diameter=2.4e-3, inner_diameter=1e-3)
    mesh = TubeMesh(tube, rings=60, sides=24)
    points = mesh.vertices(mesh.line(arc_shape(), 0.02))
    assert len(points) == mesh.count
    corners = points[mesh.faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    polygon = 0.5 * 24 * np.sin(2.0 * np.pi / 24) * 1.2e-3**2
    assert volume == pytest.approx(polygon * 0.15, rel=2e-3)
    # In a closed surface every edge belongs to two triangles, once the repeated rims are merged.
    _, same = np.unique(points.round(9), axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    assert edges == {(b, a) for a, b in edges}


def test_a_wider_drawn_tube_hides_the_narrower_one(paper_robot: Robot) -> None:
    inner, outer = paper_robot.tubes
    flat = np.cos(np.pi / 12)  # a ring of 12 points is nearer to the axis between two points
    assert flat * outer.outer_diameter > inner.outer_diameter


def test_a_bent_tube_ends_at_the_measured_tip_and_keeps_its_shape_at_the_plate(paper_robot: Robot) -> None:
    mesh, offset = TubeMesh(paper_robot.tubes[0]), np.array([0.001, 0.003, -0.001])
    length = paper_robot.tubes[0].length - 0.1
    straight, bent = (mesh.line(arc_shape(), -0.1, bend) for bend in (None, Bend(offset, length)))
    moved = bent.position - straight.position
    np.testing.assert_allclose(moved[-1], offset, atol=1e-12)
    np.testing.assert_allclose(moved[straight.arc <= 0.0], 0.0)
    assert (np.diff(np.linalg.norm(moved, axis=1)) >= 0.0).all()


@pytest.mark.parametrize("lengths", [(0.0, 0.0, 0.0), (0.0, 0.05, 0.08), (0.04, 0.09, 0.06)])
def test_tubes_that_are_flush_with_the_plate_or_inside_others_are_drawn_to_their_ends(lengths) -> None:
    robot = load_robot("three_tubes").robot()
    beta = [length - tube.length for length, tube in zip(lengths, robot.tubes, strict=True)]
    joints = np.array([
        beta[joint.tube] if joint.motion == "translation" else 0.3 * joint.tube for joint in robot.joints
    ])  # fmt: skip
    model = Statics(robot)
    solution = model.solve(joints, np.zeros(6))
    shape, rod = model.shape(solution), ExactRod(robot).solve(joints, np.zeros(6))
    for tube, start in zip(robot.tubes, beta, strict=True):
        line = TubeMesh(tube).line(shape, start)
        assert np.isfinite(line.position).all()
        assert np.isfinite(line.frame).all()
        assert np.allclose(line.position[0], [0.0, 0.0, start])
    assert np.allclose(TubeMesh(robot.tubes[0]).line(shape, beta[0]).position[-1], rod.tip, atol=1e-6)


def test_a_magnified_tube_is_wider_and_has_the_same_centre_line(paper_robot: Robot) -> None:
    mesh = TubeMesh(paper_robot.tubes[0])
    line = mesh.line(arc_shape(), 0.0)
    true, wide = mesh.vertices(line), mesh.vertices(line, 2.0)
    np.testing.assert_allclose(wide[-1], true[-1])
    np.testing.assert_allclose(wide[:12] - line.position[0], 2.0 * (true[:12] - line.position[0]), atol=1e-12)
