import math
import re
from dataclasses import replace

import numpy as np
import pytest

from core.errors import DescriptionError, PoseError
from core.robot.keep_out import KeepOut
from core.robot.limits import Configuration, ForceLimit, JointLimit, Limits, TubeOrder, Workspace
from core.robot.regions import Region
from core.robot.robot import Robot

DEGREE = math.pi / 180.0
SLIDE = JointLimit("inner_translation", "m", -0.130, -0.005, speed=0.020, acceleration=0.100)
TURN = JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, speed=20 * DEGREE, acceleration=100 * DEGREE)
LIMITS = Limits((TURN, SLIDE), reaction=0.050)

INSIDE = [share * (limit.upper - limit.lower) + limit.lower for limit, share in ((TURN, 0.5), (SLIDE, 0.5))]


def stop(position: float, velocity: float, acceleration: float, reaction: float) -> float:
    """Return the stopping position of a joint that continues for the reaction time and then brakes (small steps)."""
    dt = 1e-5
    position += velocity * reaction
    while velocity != 0.0:
        slower = math.copysign(max(abs(velocity) - acceleration * dt, 0.0), velocity)
        position += 0.5 * (velocity + slower) * dt
        velocity = slower
    return position


@pytest.mark.parametrize("limit", [TURN, SLIDE], ids=lambda limit: limit.name)
@pytest.mark.parametrize("reaction", [0.0, 0.200])
@pytest.mark.parametrize("room", [0.0, 1e-3, 0.05])
def test_a_joint_at_its_highest_allowed_velocity_stops_inside_its_travel(limit, reaction, room):
    distance = room * (limit.upper - limit.lower)
    limits = Limits((limit,), reaction)
    for position, side in ((limit.upper - distance, 1), (limit.lower + distance, 0)):
        velocity = limits.velocity_bounds(np.array([position]))[side][0]
        rest = stop(position, velocity, limit.acceleration, reaction)
        bound = limit.upper if side else limit.lower
        overshoot = (rest - bound) if side else (bound - rest)

        assert overshoot <= 1e-9
        # The velocity bound is not conservative: it is below top speed only where necessary.
        assert overshoot == pytest.approx(0.0, abs=1e-6) or abs(velocity) == limit.speed


@pytest.mark.parametrize("limit", [TURN, SLIDE], ids=lambda limit: limit.name)
def test_a_joint_commanded_at_its_velocity_bound_with_a_third_of_the_reaction_time_stays_in_its_travel(limit):
    limits, dt = Limits((limit,), reaction=0.060), 1e-3
    pending = [0.0] * 20
    position, velocity, furthest = limit.upper - 0.5 * limit.speed, 0.0, -math.inf

    for _ in range(4000):
        pending.append(limits.velocity_bounds(np.array([position]))[1][0])
        largest = limit.acceleration * dt
        velocity += min(max(pending.pop(0) - velocity, -largest), largest)
        position += velocity * dt
        furthest = max(furthest, position)

    assert limit.upper - 1e-3 * limit.speed < furthest <= limit.upper + 1e-12


@pytest.mark.parametrize(
    ("joints", "lower", "upper"),
    [
        (INSIDE, [-20 * DEGREE, -0.020], [20 * DEGREE, 0.020]),  # at top speed in both directions
        ([-7.0, 0.010], [0.0, -0.020], [20 * DEGREE, 0.0]),  # outside the travel only inward
    ],
)
def test_a_joint_may_move_at_top_speed_inside_its_travel_and_only_inward_outside(joints, lower, upper):
    np.testing.assert_allclose(LIMITS.velocity_bounds(np.array(joints)), [lower, upper])
    np.testing.assert_allclose(LIMITS.speed, [20 * DEGREE, 0.020])


def test_a_joint_at_a_nan_position_must_not_move():
    lower, upper = LIMITS.velocity_bounds(np.array([math.nan, math.nan]))

    assert not (lower < 0.0).any()
    assert not (upper > 0.0).any()


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([0.0, -0.150], ["inner_translation", "-0.15 m", "-0.13 ... -0.005 m", "travel"]),
        ([0.0, 0.0], ["inner_translation", "0 m", "-0.13 ... -0.005 m"]),
        ([6.5, -0.1], ["outer_rotation", "6.5 rad", "-6.283 ... 6.283 rad"]),
        ([math.nan, -0.1], ["outer_rotation", "nan rad"]),
        ([0.0, math.inf], ["inner_translation", "inf m"]),
    ],
)
def test_a_joint_position_outside_its_travel_is_refused_by_name_value_and_bound(joints, words):
    with pytest.raises(PoseError) as refused:
        LIMITS.check(np.array(joints))

    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("joints", [[0.0, -0.130], [2 * math.pi, -0.005], INSIDE])
def test_the_travel_of_a_joint_includes_its_ends(joints):
    LIMITS.check(np.array(joints))


def situation(joints=(0.0, 0.0), jacobian=None, tip=(0.0, 0.0, 0.3), force=(0.0, 0.0, 0.0)) -> Configuration:
    jacobian = np.zeros((3, len(joints))) if jacobian is None else jacobian
    return Configuration(np.array(joints, dtype=float), jacobian, np.array(tip), np.array(force))


def order_of(robot: Robot, lower: float, upper: float, ends: bool = True) -> TubeOrder:
    """Return the tube order of a robot whose tubes slide from `lower` to `upper` [m]."""
    travel = [
        JointLimit(j.name, j.unit, lower, upper, 0.02, 0.1) if j.motion == "translation" else replace(TURN, name=j.name)
        for j in robot.joints
    ]
    order = TubeOrder.of(robot, tuple(travel), ends)
    assert order is not None
    return order


def test_the_papers_tubes_need_no_order_limit_because_of_their_travel(paper_robot):
    travel = (replace(TURN, name="a"), replace(TURN, name="b"), SLIDE)

    assert TubeOrder.of(paper_robot, travel) is None


def test_tubes_that_could_pass_each_other_have_one_order_row_each(three_tubes):
    order = order_of(three_tubes, -0.2, 0.0)
    slides = [k for k, joint in enumerate(three_tubes.joints) if joint.motion == "translation"]

    def at(*beta: float) -> Configuration:
        joints = np.zeros(6)
        joints[slides] = beta
        return situation(joints)

    # Tube a is inside b, and b is inside c: each tube starts behind the next outer tube and ends beyond it.
    order.check(at(-0.05, -0.03, -0.01))
    rows, room = order.rows(at(-0.05, -0.03, -0.01))
    assert (room > 0.0).all()
    # Stages receive commands one at a time, so within half a millimetre of the edge no approach is allowed.
    assert order.rows(at(-0.0304, -0.03, -0.01))[1].min() == 0.0 < order.rows(at(-0.0306, -0.03, -0.01))[1].min()
    with pytest.raises(
        PoseError, match=r"tube order is violated by 10 mm; required: start of tube 'a' behind that of tube 'b'"
    ):
        order.check(at(-0.02, -0.03, -0.01))
    with pytest.raises(PoseError, match=r"violated by 20 mm; required: end of tube 'a' beyond that of tube 'b'"):
        order.check(at(-0.15, -0.03, -0.01))
    # When tube a has reached tube b, tube a must not move further alone; both tubes may move together.
    rows, room = order.rows(at(-0.03, -0.03, -0.01))
    alone, together = np.zeros(6), np.zeros(6)
    alone[slides[0]] = together[slides[0]] = together[slides[1]] = 0.001
    assert (rows @ alone > room).any()
    assert (rows @ together <= room).all()


def test_the_tube_order_allows_exactly_the_valid_poses(three_tubes):
    order, random, fits = order_of(three_tubes, -0.25, 0.05, ends=False), np.random.default_rng(8), 0
    exposed, exposing = order_of(three_tubes, -0.25, 0.05), 0
    for _ in range(200):
        joints = np.zeros(6)
        slides = [k for k, joint in enumerate(three_tubes.joints) if joint.motion == "translation"]
        joints[slides] = random.uniform(-0.25, 0.05, 3)
        valid = True
        try:
            three_tubes.check_pose(joints)
        except PoseError:
            valid = False
        allowed = bool((order.matrix @ joints <= order.bound).all())
        assert allowed == valid
        fits += valid
        beyond = valid and bool((np.diff(three_tubes.tube_ends(joints)) <= 0.0).all())
        assert beyond == bool((exposed.matrix @ joints <= exposed.bound).all())
        exposing += beyond
    assert 4 < exposing < fits < 196


def test_a_workspace_slows_the_tip_only_toward_its_faces():
    box = Workspace((-0.1, -0.1, 0.1), (0.1, 0.1, 0.3))
    rows, room = box.rows(situation((0.0, 0.0, 0.0), np.eye(3), tip=(0.0, 0.0, 0.299)))

    assert (rows @ np.array([0.0, 0.0, 0.01]) > room).any()  # 1 mm before the face a speed of 10 mm/s is too fast
    assert (rows @ np.array([0.0, 0.0, 0.003]) <= room).all()
    assert (rows @ np.array([0.0, 0.0, -0.02]) <= room).all()
    outside = box.rows(situation((0.0, 0.0, 0.0), np.eye(3), tip=(0.0, 0.0, 0.31)))[1]
    assert (outside >= 0.0).all()  # zero velocity is always allowed
    with pytest.raises(PoseError, match=r"tip z 0.31 m is outside 0.1 \.\.\. 0.3 m \(the workspace\)"):
        box.check(situation(tip=(0.0, 0.0, 0.31)))
    assert box.names[2] == "workspace z <= 0.3 m"
    assert box.names[5] == "workspace z >= 0.1 m"


def test_a_force_limit_lets_the_tip_yield_but_not_push_against_the_load():
    limit = ForceLimit(0.5)
    push, give = np.array([-0.01, 0.0, 0.0]), np.array([0.01, 0.0, 0.0])
    for force, may_push in ((0.0, True), (0.5, False), (0.7, False)):
        rows, room = limit.rows(situation((0.0, 0.0, 0.0), np.eye(3), force=(force, 0.0, 0.0)))
        assert (rows @ give <= room).all()
        assert bool((rows @ push <= room).all()) is may_push
        assert (room >= 0.0).all()
    with pytest.raises(PoseError, match=r"force on the tip 0.7 N is above 0.5 N"):
        limit.check(situation(force=(0.0, 0.7, 0.0)))


def test_the_active_limits_are_named_with_value_and_unit():
    limits = Limits((TURN, SLIDE), others=(ForceLimit(0.5),))
    joints = np.array([0.0, -0.0051])

    assert limits.active(joints, np.array([1.0, 1.0]), np.array([1.0])) == (
        "speed of outer_rotation (0.3491 rad/s)",
        "travel of inner_translation (-0.005 m)",
        "force on the tip (0.5 N)",
    )
    assert limits.active(joints, np.zeros(2), np.zeros(1)) == ()
    # This command has no limits that involve several joints.
    assert Limits((TURN, SLIDE)).active(joints, np.zeros(2), np.zeros(0)) == ()


def test_several_active_rows_of_one_name_are_reported_once(paper_robot):
    region = KeepOut(Region("ball", "sphere", (0.0, 0.0, 0.1, 0.01)))
    joints = tuple(JointLimit(joint.name, joint.unit, -1.0, 1.0, 0.1, 1.0) for joint in paper_robot.joints)
    active = replace(Limits(joints), others=(region,)).active(np.zeros(3), np.zeros(3), np.ones(len(region.names)))

    assert active == tuple(dict.fromkeys(region.names))
    assert len(active) == 5


@pytest.mark.parametrize(
    ("at_bound", "at_row", "blocks"),
    [([0, 0], [0], False), ([1, 0], [0], False), ([0, 1], [0], True), ([0, 0], [1], True)],
)
def test_a_joint_at_top_speed_is_not_blocked_but_one_at_the_end_of_its_travel_is(at_bound, at_row, blocks):
    limits = Limits((TURN, SLIDE), others=(ForceLimit(0.5),))

    assert limits.blocking(np.array([0.0, -0.0051]), np.array(at_bound, float), np.array(at_row, float)) is blocks


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: replace(SLIDE, lower=-0.005, upper=-0.130), "inner_translation: travel -0.005 ... -0.13 m is empty"),
        (lambda: replace(SLIDE, lower=-0.005), "inner_translation: travel -0.005 ... -0.005 m is empty"),
        (lambda: replace(SLIDE, upper=math.nan), "inner_translation: travel -0.13 ... nan m"),
        (lambda: replace(SLIDE, lower=-math.inf), "inner_translation: travel -inf ... -0.005 m"),
        (lambda: replace(SLIDE, speed=0.0), "inner_translation: speed limit 0 m/s must be greater than 0"),
        (lambda: replace(SLIDE, speed=math.nan), "inner_translation: speed limit nan m/s"),
        (lambda: replace(SLIDE, acceleration=-0.1), "acceleration limit -0.1 m/s^2 must be greater than 0"),
        (lambda: replace(SLIDE, acceleration=math.inf), "inner_translation: acceleration limit inf m/s^2"),
        (lambda: Limits((SLIDE,), -0.010), "reaction time -0.01 s"),
        (lambda: Limits((SLIDE,), math.nan), "reaction time nan s"),
        (lambda: Limits((SLIDE,), math.inf), "reaction time inf s"),
        (lambda: Workspace((0.0, 0.0, 0.3), (0.1, 0.1, 0.1)), "workspace: z 0.3 ... 0.1 m is empty"),
        (lambda: Workspace((0.0, math.nan, 0.0), (0.1, 0.1, 0.1)), "workspace: y nan ... 0.1 m"),
        (lambda: ForceLimit(0.0), "force limit: max_force 0 N must be finite and greater than 0"),
        (lambda: ForceLimit(0.5, math.inf), "force limit: speed inf m/s"),
    ],
)
def test_an_invalid_limit_is_refused_by_name_value_and_unit(make, words):
    with pytest.raises(DescriptionError, match=re.escape(words)):
        make()
