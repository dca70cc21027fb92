"""Motions in files are converted to the trajectories and tasks that the controller tracks."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from core.control.trajectories import MAX_WAYPOINTS, JointMotion, Setpoint
from core.errors import CtrError, Unreachable
from core.model.statics import Statics
from station.config.controllers import ControllerFile
from station.config.motions import MAX_FILE_BYTES, JointSweepMotion, Motion, Orders, PalpateMotion, WaypointsMotion
from station.config.strict import ConfigError, Strict, check


class Holder(Strict):
    motion: Motion


@pytest.fixture
def orders(paper_robot):
    """Return a function that converts a file's table to the orders of its motion."""

    def make(**table: object) -> Orders:
        return Orders(check(Holder, {"motion": table}, "file").motion, paper_robot)

    return make


def setpoint(orders: Orders, time: float) -> Setpoint:
    order = orders.at(time)
    assert isinstance(order, Setpoint)
    return order


def test_hold_keeps_the_start_tip_as_setpoint(orders):
    for time in (0.0, 1.0, 1e4):
        position, velocity = setpoint(orders(kind="hold"), time)[:2]
        assert not position.any()
        assert not velocity.any()


def test_sinusoid_motion_equals_its_closed_form_along_a_direction_of_any_length(orders):
    motion = orders(kind="sinusoid", direction=[0, -3, 4], amplitude=0.010, frequency=0.05)

    # After a quarter of the 20 s period the tip is at rest, 10 mm along (0, -0.6, 0.8). At the start its speed is
    # 2 pi 0.05 * 10 mm = pi mm/s.
    assert setpoint(motion, 5.0).position == pytest.approx([0.0, -0.006, 0.008], abs=1e-15)
    assert setpoint(motion, 5.0).velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    assert setpoint(motion, 0.0).position == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    assert setpoint(motion, 0.0).velocity == pytest.approx([0.0, -0.6e-3 * math.pi, 0.8e-3 * math.pi], abs=1e-15)
    assert setpoint(motion, 5.0 / 3.0).position == pytest.approx([0.0, -0.003, 0.004], abs=1e-15)


def test_circle_motion_starts_at_the_tip_keeps_radius_and_plane_and_closes(orders):
    motion = orders(kind="circle", radius=0.010, period=8.0, normal=[1, 2, 2])
    points = np.array([setpoint(motion, time).position for time in np.linspace(0.0, 8.0, 81)])
    centre = points[:-1].mean(axis=0)

    assert points[0] == pytest.approx(np.zeros(3), abs=1e-15)
    assert points[-1] == pytest.approx(np.zeros(3), abs=1e-15)
    assert np.linalg.norm(points - centre, axis=1) == pytest.approx(np.full(81, 0.010))
    assert points @ [1.0, 2.0, 2.0] == pytest.approx(np.zeros(81), abs=1e-15)
    # The speed is the circumference divided by the period.
    assert np.linalg.norm(setpoint(motion, 3.0).velocity) == pytest.approx(0.02 * math.pi / 8.0)


def test_joint_sweep_moves_one_joint_until_its_distance_is_covered(orders):
    sweep = orders(kind="joint_sweep", joint="inner_translation", speed=-0.004, distance=0.010)

    for time in (0.0, 1.0, 2.499):
        order = sweep.at(time)
        assert isinstance(order, JointMotion)
        assert order.velocity.tolist() == [0.0, 0.0, -0.004]
    for time in (2.5, 3.0, 100.0):
        order = sweep.at(time)
        assert isinstance(order, JointMotion)
        assert not order.velocity.any()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"kind": "sinusoid", "amplitude": 0.01, "frequency": 1.0, "direction": [0, 0, 0]},
            "motion.direction = [0, 0, 0]: the length of a direction must be",
        ),
        ({"kind": "hold", "radius": 0.01}, "unknown key 'motion.radius'"),
        ({"kind": "spiral"}, "motion = {'kind': 'spiral'}: "),
        ({"amplitude": 0.01}, "motion = {'amplitude': 0.01}: "),
    ],
)
def test_invalid_motion_is_refused_by_key_and_value(table, message):
    with pytest.raises(ConfigError) as refused:
        check(Holder, {"motion": table}, "file")

    assert str(refused.value).startswith(f"file: {message}")


def test_sweep_of_an_unknown_joint_is_refused_with_the_names_of_the_robots_joints(orders):
    with pytest.raises(CtrError, match="'elbow' is not one of outer_rotation, inner_rotation, inner_translation"):
        orders(kind="joint_sweep", joint="elbow", speed=0.1, distance=1.0)


@pytest.mark.parametrize(
    ("joint", "speed", "distance", "message"),
    [
        ("inner_translation", 0.01, 0.096, "inner_translation -0.004 m is outside -0.13 ... -0.005 m"),
        ("inner_translation", -0.01, 0.031, "inner_translation -0.131 m is outside -0.13 ... -0.005 m"),
        ("inner_translation", 0.021, 0.010, "speed 0.021 m/s is outside +-0.02 m/s"),
        ("outer_rotation", -0.05, 6.3, "outer_rotation -6.3 rad is outside -6.283 ... 6.283 rad"),
    ],
)
def test_joint_sweep_faster_than_the_stage_or_beyond_its_travel_is_refused(paper, joint, speed, distance, message):
    sweep = JointSweepMotion(joint=joint, speed=speed, distance=distance)

    with pytest.raises(CtrError) as refused:
        sweep.check(np.array([0.0, math.pi / 2, -0.1]), Statics(paper.robot()), paper.limits())
    assert message in str(refused.value)


def test_helix_and_waypoints_motions_follow_their_definitions(orders):
    helix = orders(kind="helix", radius=0.005, pitch=0.003, turn=4.0, turns=2.0)
    assert setpoint(helix, 4.0).position == pytest.approx([0.0, 0.0, 0.003], abs=1e-12)
    assert setpoint(helix, 100.0).position == pytest.approx([0.0, 0.0, 0.006], abs=1e-12)
    path_orders = orders(kind="waypoints", points=[[5, 0.01, 0, 0], [10.0, 0.01, 0.01, 0.0]])
    assert setpoint(path_orders, 5.0).position == pytest.approx([0.01, 0.0, 0.0], abs=1e-12)
    assert setpoint(path_orders, 50.0).position == pytest.approx([0.01, 0.01, 0.0], abs=1e-12)


def test_step_motion_stays_or_alternates_between_its_two_positions(orders):
    once, again = orders(kind="step", offset=[1e-3, 0, 0]), orders(kind="step", offset=[1e-3, 0, 0], stay=2.0)

    assert setpoint(once, 3.0).position.tolist() == [1e-3, 0.0, 0.0]
    assert setpoint(again, 1.0).position.tolist() == [1e-3, 0.0, 0.0]
    assert setpoint(again, 3.0).position.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])  # some programs write a byte order mark
@pytest.mark.parametrize("head", ["time [s], x [m], y, z\n", ""])
def test_csv_motion_reads_its_file_as_waypoints(orders, tmp_path, head, encoding):
    path = tmp_path / "path.csv"
    path.write_text(f"{head}5, 0.01, 0, 0\n\n10.0,0.01,0.01,0.0\n", encoding=encoding)

    from_file, written = (
        orders(kind="csv", file=str(path)),
        orders(kind="waypoints", points=[[5.0, 0.01, 0.0, 0.0], [10.0, 0.01, 0.01, 0.0]]),
    )

    for time in (0.0, 2.0, 7.0, 20.0):
        assert setpoint(from_file, time).position.tolist() == setpoint(written, time).position.tolist()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n", "path.csv: line 1: 3 numbers; expected time, x, y, z"),
        ("time,x,y,z\n5,0,0,zero\n", "path.csv: line 2: '5,0,0,zero' is not time, x, y, z in numbers"),
        ("5,nan,0,0\n", "path.csv: points.0.1 = nan"),
        ("5,0,0,0\n4,0,0,0\n", "waypoints: time 4 s must be after the time 5 s"),
        ("0.1,0.05,0,0\n", "give the points around it more time"),
        ("time,x,y,z\n", "path.csv: points = []"),
    ],
)
def test_invalid_csv_file_of_waypoints_is_refused_with_its_line(orders, tmp_path, text, message):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(CtrError) as refused:
        orders(kind="csv", file=str(path))
    assert message in str(refused.value)


def test_csv_file_with_too_many_waypoints_is_refused_before_its_numbers_are_read(orders, tmp_path):
    path = tmp_path / "path.csv"
    rows = ["1,0,0,0"] * MAX_WAYPOINTS
    path.write_text("\n".join(["time,x,y,z", "", *rows]), encoding="utf-8")
    with pytest.raises(ConfigError, match="must be after the time"):  # as many waypoints as possible are read
        orders(kind="csv", file=str(path))
    path.write_text("\n".join(["time,x,y,z", "", *rows, "no number"]), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"path\.csv: 10001 waypoints; at most 10000 are possible; remove waypoints"):
        orders(kind="csv", file=str(path))


def test_csv_file_that_is_too_large_for_waypoints_is_not_read(orders, tmp_path):
    path = tmp_path / "path.csv"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(ConfigError, match=rf"has {MAX_FILE_BYTES + 1} bytes; at most {MAX_FILE_BYTES} are read"):
        orders(kind="csv", file=str(path))


def test_long_list_of_waypoints_is_checked_no_further_than_its_first_invalid_row():
    with pytest.raises(ValidationError) as refused:
        WaypointsMotion.model_validate({"points": [[0.0]] * 100 * MAX_WAYPOINTS})
    assert {error["loc"][:2] for error in refused.value.errors()} == {("points",), ("points", 0)}


def test_missing_csv_file_of_waypoints_is_refused(orders, tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        orders(kind="csv", file=str(tmp_path / "none.csv"))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "waypoints", "points": [[0.0, 0.01, 0.0, 0.0]]}, "above 0 s, so that the tip can get there"),
        ({"kind": "step", "offset": [0.0, math.inf, 0.0]}, "motion.offset.1 = inf: "),
    ],
)
def test_invalid_helix_waypoints_or_step_is_refused_by_key(table, message):
    with pytest.raises(ConfigError) as refused:
        check(Holder, {"motion": table}, "file")

    assert message in str(refused.value)


def test_infeasible_motion_is_refused_with_kind_time_and_limit(orders, paper):
    controller, start = ControllerFile().controller(paper), np.array([0.0, math.pi / 2, -0.1])
    orders(kind="circle", radius=0.010, period=12.0).check(controller, start, 60.0)
    orders(kind="joint_sweep", joint="outer_rotation", speed=0.1, distance=1.0).check(controller, start, 60.0)

    with pytest.raises(Unreachable, match=r"circle cannot be followed: at 7\.8.* s .* because of speed of"):
        orders(kind="circle", radius=0.015, period=12.0).check(controller, start, 60.0)
    with pytest.raises(CtrError, match="inner_translation"):
        orders(kind="joint_sweep", joint="inner_translation", speed=0.01, distance=0.2).check(controller, start, 60.0)


def test_palpation_visits_a_grid_around_the_start_tip_and_turns_at_the_end_of_each_row():
    motion = PalpateMotion(
        direction=(2.0, 0.0, 0.0), across=(1.0, 3.0, 0.0), columns=3, rows=2, spacing=0.002, light=0.05, force=0.2
    )
    places = motion.trajectory().places

    # The rows are along y, from z = -1 mm to z = 1 mm.
    expected = [(0, -2, -1), (0, 0, -1), (0, 2, -1), (0, 2, 1), (0, 0, 1), (0, -2, 1)]
    assert np.array(places) == pytest.approx(1e-3 * np.array(expected))
    assert motion.grid == ((0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0))
    assert motion.trajectory().firm.direction == pytest.approx([1.0, 0.0, 0.0])
