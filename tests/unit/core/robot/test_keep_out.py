"""The limit that keeps the tubes out of regions: clearance, rows, and the check of a pose."""

import numpy as np
import pytest
import trimesh

from core.errors import PoseError
from core.robot.keep_out import RESERVE_M, KeepOut, region_at
from core.robot.limits import Backbone, Configuration
from core.robot.regions import Region, mesh
from core.robot.robot import Array


def straight(points: Array, radius: float = 0.001) -> Backbone:
    """Return tubes of one radius along points (m, 3), whose joints move each point along x, y and z."""
    at_rest = np.zeros_like(points), np.zeros_like(points)
    return Backbone(
        points, np.full(len(points), radius), np.tile(np.eye(3), (len(points), 1, 1)), *at_rest, len(points)
    )


def along_z(x: float, y: float = 0.0, lower: float = 0.0, upper: float = 0.1, count: int = 33) -> Backbone:
    """Return straight tubes along z."""
    return straight(np.array([[x, y, z] for z in np.linspace(lower, upper, count)]))


def at(line: Backbone) -> Configuration:
    """Return a configuration in which each joint moves the tip along one axis."""
    return Configuration(np.zeros(3), np.eye(3), line.points[-1], np.zeros(3), line)


BALL = Region("ball", "sphere", (0.0, 0.0, 0.05, 0.008), margin=0.001)


def test_clearance_counts_radius_and_margin_and_finds_the_point_between_two_points() -> None:
    """A line along z at 12 mm from the centre of a sphere of 8 mm; its nearest point is between two of its points."""
    line = along_z(0.012, count=21)
    region = Region("ball", "sphere", (0.0, 0.0, 0.0523, 0.008), margin=0.0015)
    found = KeepOut(region).clearance(line)

    assert found.distance == pytest.approx(0.012 - 0.008 - 0.001 - 0.0015, abs=2e-5)
    assert found.point[2] == pytest.approx(0.0523, abs=4e-4)
    assert np.allclose(found.nearest, (0.008, 0.0, 0.0523), atol=4e-4)
    assert np.allclose(found.direction, (1.0, 0.0, 0.0), atol=0.05)


@pytest.mark.parametrize("height", [0.001, 0.0022, 0.0978, 0.099])
def test_clearance_is_found_between_the_last_two_points_of_the_tubes(height: float) -> None:
    """Points at distances of 6 mm, and a sphere of 5 mm, miss the nearest point by half a millimetre."""
    line = along_z(0.0075, count=17)
    found = KeepOut(Region("ball", "sphere", (0.0, 0.0, height, 0.005), margin=0.0)).clearance(line)

    assert found.distance == pytest.approx(0.0075 - 0.005 - 0.001, abs=3e-5)
    assert found.point[2] == pytest.approx(height, abs=6e-4)


def test_a_limit_that_has_measured_other_tubes_finds_the_clearance_of_a_new_limit() -> None:
    """The tubes move in a tube of triangles, in small and large steps; measured distances must not outlive a motion."""
    wall = trimesh.creation.cylinder(radius=0.012, height=0.3, sections=24)
    region = Region("lumen", "mesh", (), inside=True, margin=0.001, mesh=mesh(np.asarray(wall.triangles)))
    used, random = KeepOut(region), np.random.default_rng(8)
    base = np.array([[0.0, 0.0, z] for z in np.linspace(-0.1, 0.1, 32)])
    shift, bend = np.zeros(3), np.zeros(3)
    for number in range(120):
        step = 3e-3 if number % 20 == 0 else 1e-5
        shift = np.clip(shift + step * random.normal(size=3), -0.004, 0.004)
        bend = np.clip(bend + step * random.normal(size=3), -0.004, 0.004)
        line = straight(base + shift + np.outer(np.linspace(0.0, 1.0, 32) ** 2, bend))
        found, wanted = used.evaluated(line), KeepOut(region).evaluated(line)
        assert np.array_equal(found.parts, wanted.parts)
        assert np.array_equal(found.rows, wanted.rows)
        assert np.array_equal(found.room, wanted.room)


def test_clearance_of_a_region_in_front_of_the_tip_is_that_of_the_tip() -> None:
    line = along_z(0.0, upper=0.2, count=32)
    found = KeepOut(Region("ball", "sphere", (0.0, 0.0, 0.212, 0.008), margin=0.001)).clearance(line)

    assert found.distance == pytest.approx(0.212 - 0.2 - 0.008 - 0.001 - 0.001, abs=1e-12)
    assert np.allclose(found.point, (0.0, 0.0, 0.2))


@pytest.mark.parametrize(("drift", "pushed"), [(-0.004, -0.004), (0.004, 0.0), (-0.010, -0.010)])
def test_a_load_that_pushes_toward_a_region_leaves_less_room(drift: float, pushed: float) -> None:
    line = along_z(0.012)
    line.drift[:, 0] = drift
    limit = KeepOut(BALL)

    room = max((0.002 - RESERVE_M) / 0.25 + pushed, 0.0)
    assert limit.rows(at(line))[1].min() == pytest.approx(room, rel=0.01, abs=1e-12)


def test_motion_that_a_command_cannot_change_counts_as_travelled() -> None:
    line = along_z(0.012)
    line.ahead[:, 0] = -0.0015
    limit = KeepOut(BALL)

    assert limit.rows(at(line))[1].min() == pytest.approx((0.0005 - RESERVE_M) / 0.25, rel=0.02)
    assert limit.clearance(line).distance == pytest.approx(0.002, abs=2e-5)


def test_rows_bound_the_approach_by_the_clearance_over_a_quarter_of_a_second() -> None:
    line = along_z(0.012)
    limit = KeepOut(BALL)
    rows, room = limit.rows(at(line))

    assert len(limit.names) == len(rows) == len(room)
    nearest = int(room.argmin())
    assert np.allclose(rows[nearest], (-1.0, 0.0, 0.0), atol=0.01)  # toward the ball, against x
    assert room[nearest] == pytest.approx((0.002 - RESERVE_M) / 0.25, rel=0.01)


def duct(x: float, y: float) -> tuple[KeepOut, Array, Array]:
    """Return limit, rows and room of tubes along z in a square duct whose walls are at x = 10 mm and y = 10 mm."""
    triangles = np.asarray(trimesh.creation.box((0.02, 0.02, 0.3)).triangles)
    limit = KeepOut(Region("duct", "mesh", (), inside=True, margin=0.001, mesh=mesh(triangles)))
    near = along_z(x, y)
    return limit, *limit.rows(at(near))


def test_both_walls_of_a_corner_bound_the_approach() -> None:
    """The wall at y = 10 mm is 0.4 mm farther away than the nearest wall, and has its own row."""
    _, rows, room = duct(0.0075, 0.0071)
    for axis, clearance in ((0, 0.0005), (1, 0.0009)):
        toward = np.isclose(rows, np.eye(3)[axis], atol=1e-9).all(axis=1)
        assert toward.any()
        assert room[toward].max() == pytest.approx((clearance - RESERVE_M) / 0.25, rel=1e-6)


def test_tubes_between_two_walls_brake_in_front_of_both() -> None:
    """Two cubes of 5 mm beside the same part of the tubes, 12 mm apart: one on the side of x, one on that of y."""
    box = np.asarray(trimesh.creation.box((0.005,) * 3).triangles)
    walls = mesh(np.concatenate((box + np.array([0.0048, 0.0, 0.08]), box + np.array([0.0, 0.0051, 0.092]))))
    limit = KeepOut(Region("walls", "mesh", (), mesh=walls, margin=0.001))
    found = limit.evaluated(along_z(0.0))

    for axis, clearance in ((0, 0.0003), (1, 0.0006)):
        toward = found.room[found.rows[:, axis] > 0.99]
        assert toward.min() == pytest.approx((clearance - RESERVE_M) / 0.25, rel=0.02)


def test_a_point_that_will_be_nearer_to_another_wall_brakes_in_front_of_it() -> None:
    """The tubes move from the wall at x = 10 mm to that at y = 10 mm before a command takes effect."""
    limit, *_ = duct(0.0075, 0.0)
    near = along_z(0.0075, 0.0060)
    near.ahead[:] = (-0.001, 0.0015, 0.0)
    rows, room = limit.rows(at(near))

    assert np.allclose(rows[room.argmin()], (0.0, 1.0, 0.0))
    assert room.min() == pytest.approx((0.0005 - RESERVE_M) / 0.25, rel=1e-6)
    assert limit.clearance(near).distance == pytest.approx(0.0005, abs=1e-9)


def test_a_convex_surface_bounds_only_the_approach_to_its_nearest_point() -> None:
    """The line passes the edge of a box outside of it; no row bounds its motion along a face."""
    box = Region("box", "mesh", (), mesh=mesh(np.asarray(trimesh.creation.box((0.02, 0.02, 0.02)).triangles)))
    near = along_z(0.0125, 0.0075, -0.05, 0.05)
    rows, _ = KeepOut(box).rows(at(near))

    close = np.abs(rows[:, 0] + 1.0) < 1e-9
    assert close.any()
    assert np.allclose(rows[close][:, 1:], 0.0)
    assert rows[:, 1].min() > -1e-9  # no row bounds the motion along -y, away from the edge


def test_rows_of_neighbouring_points_bound_a_rotation_about_the_nearest_point() -> None:
    """The only joint turns the tubes about their nearest point, whose own row does not contain it."""
    points = np.array([[0.012, 0.0, z] for z in np.linspace(-0.048, 0.048, 33)])
    turn = np.zeros((33, 3, 1))
    turn[:, 0, 0] = -points[:, 2]
    near = straight(points)._replace(jacobian=turn)
    limit = KeepOut(Region("ball", "sphere", (0.0, 0.0, 0.0, 0.0099), margin=0.001))
    rows, room = limit.rows(Configuration(np.zeros(1), np.zeros((3, 1)), points[-1], np.zeros(3), near))
    close = room < 0.01

    assert rows[room.argmin()] == pytest.approx(0.0, abs=1e-4)
    assert rows[close].max() > 0.0014
    assert rows[close].min() < -0.0014


def test_region_of_a_point_is_the_one_whose_margin_the_point_misses() -> None:
    ball, lumen = (
        Region("ball", "sphere", (0.0, 0.0, 0.0, 0.01)),
        Region("lumen", "sphere", (0.0, 0.0, 0.0, 0.05), inside=True),
    )
    limits = [KeepOut(ball), KeepOut(lumen)]
    for x, name in ((0.0105, "ball"), (0.02, None), (0.0495, "lumen"), (0.2, "lumen")):
        assert region_at(limits, np.array([x, 0.0, 0.0])) == name


def test_tubes_must_stay_inside_an_allowed_region() -> None:
    limit = KeepOut(Region("lumen", "capsule", (0.0, 0.0, -0.01, 0.0, 0.0, 0.2, 0.01), inside=True, margin=0.002))
    for shift, clearance in ((0.0, 0.007), (0.005, 0.002), (0.009, -0.002)):
        line = along_z(shift)
        assert limit.clearance(line).distance == pytest.approx(clearance, abs=1e-9)
        if clearance > 0.0:
            limit.check(at(line))
        else:
            with pytest.raises(PoseError, match=r"0.00 mm inside the region 'lumen'.*required: 2 mm"):
                limit.check(at(line))


def test_the_margin_is_missed_by_its_tolerance_at_most() -> None:
    limit = KeepOut(BALL)
    limit.check(at(along_z(0.00995)))
    with pytest.raises(PoseError, match=r"0.80 mm outside the region 'ball' near \(10, 0, 50\) mm"):
        limit.check(at(along_z(0.0098)))
