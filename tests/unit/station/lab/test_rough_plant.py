"""The true robot of a real bench: friction, clearance and weight in the rod, each base with its own tube."""

import math
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from core.control.force_fusion import fuse
from core.model.cosserat import ExactRod
from core.robot.robot import Joint, Robot, Section, Tube
from station.config.robots import load_robot
from station.lab.config import PlantConfig, load_lab
from station.lab.rough_plant import STANDARD, RoughPlant
from station.lab.true_plant import true_plant

START = np.array([0.0, math.pi / 2, -0.100])
BARE = PlantConfig(
    rod="rough", tubes={}, poisson_ratio=None, play={}, friction_force=0.0, friction_moment=0.0, step=0.005
)
EVERYTHING = {"friction": 0.15, "clearance": 1e-4, "density": 6450.0}
MU, COUPLE = 0.2, 0.010


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture
def rough(paper_robot):
    """A rough plant at the start pose, nominal but for what is given."""

    def make(**changes: object) -> RoughPlant:
        return RoughPlant(paper_robot, BARE.model_copy(update=changes), rng(), START)

    return make


def loop(points: int = 120) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stages and tip forces once round, to where it began."""
    angles = np.linspace(0.0, 2.0 * math.pi, points + 1)
    return [
        (
            START + np.array([0.3 * math.sin(a), 0.4 * (1.0 - math.cos(a)), 0.02 * math.sin(a + 1.0)]),
            np.array([0.2 * math.sin(a), 0.15 * math.cos(a), 0.2 * math.sin(a + 2.0)]),
        )
        for a in angles
    ]


def heavy(tube: Tube, density: float = 6450.0) -> float:
    """Weight of a tube [N/m]."""
    return STANDARD * density * math.pi / 4.0 * (tube.outer_diameter**2 - tube.inner_diameter**2)


def work(plant: RoughPlant, robot: Robot, way: list[tuple[np.ndarray, np.ndarray]], density: float = 0.0) -> float:
    """Done on the tubes by the load and by the stages along a way [J], by the trapezoidal rule.

    The guide's mouth bends a straight tube by M as it comes out and is pushed back along z by M^2 / (2 EI): that
    is on the sensor which bears the guide, and not on the stage that slides the tube.
    """
    rows = []
    for stages, force in way:
        state = plant.advance(stages, force)
        alpha, beta = robot.tube_poses(stages)
        bend = state.wrenches[:, 3:5] + np.c_[-beta * state.wrenches[:, 1], beta * state.wrenches[:, 0]]
        hidden = np.array([heavy(tube, density) for tube in robot.tubes]) * beta**2 / 2.0
        bend += np.c_[hidden * np.sin(alpha), hidden * np.cos(alpha)]
        mouth = np.array([m @ m / (2.0 * tube.bending_stiffness) for m, tube in zip(bend, robot.tubes, strict=True)])
        pull = np.r_[state.wrenches[:, 2] + mouth, state.wrenches[:, 5]]
        rows.append((state.truth.tip, force, np.r_[beta, alpha], -pull))
    return sum(
        float(0.5 * (f0 + f1) @ (tip1 - tip0) + 0.5 * (b0 + b1) @ (at1 - at0))
        for (tip0, f0, at0, b0), (tip1, f1, at1, b1) in pairwise(rows)
    )


def test_without_its_roughness_it_is_the_exact_rod(paper_robot, rough):
    plant, exact = rough(), ExactRod(paper_robot)

    for stages, force in loop(40):
        assert plant.advance(stages, force).truth.tip == pytest.approx(
            exact.solve(stages, np.r_[force, 0.0, 0.0, 0.0]).tip, abs=1e-7
        )


@pytest.mark.parametrize("changes", [{}, *({key: value} for key, value in EVERYTHING.items()), EVERYTHING], ids=str)
def test_the_bases_together_bear_the_load_and_the_weights_whatever_the_tubes_do_to_each_other(
    paper_robot, rough, changes
):
    # Each base is computed from its own tube alone: that they add up is Newton's third law, not an identity.
    plant = rough(**changes)
    weight = sum(heavy(tube, changes.get("density", 0.0)) * tube.length for tube in paper_robot.tubes)

    for stages, force in loop():
        state = plant.advance(stages, force)
        load = fuse(state.wrenches, *paper_robot.tube_poses(stages))
        assert load.force == pytest.approx(force + np.array([weight, 0.0, 0.0]), abs=1e-6)
        if not weight:
            assert load.moment == pytest.approx(np.cross(state.truth.tip, force), abs=2e-7)


def test_the_bases_of_three_tubes_bear_the_load_too():
    file = load_robot("three_tubes")
    three_tubes = file.robot()
    config = BARE.model_copy(update=EVERYTHING)
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in file.joints])
    plant = RoughPlant(three_tubes, config, rng(), middle)
    weight = sum(heavy(tube) * tube.length for tube in three_tubes.tubes)

    for k in range(100):
        stages = middle + np.array([0.4, 0.3, 0.5, 0.004, 0.006, 0.008]) * math.sin(0.05 * k)
        force = np.array([0.2, -0.1, 0.3]) * math.sin(0.08 * k)
        load = fuse(plant.advance(stages, force).wrenches, *three_tubes.tube_poses(stages))
        assert load.force == pytest.approx(force + np.array([weight, 0.0, 0.0]), abs=1e-6)


def test_friction_is_on_each_base_and_in_the_shape(paper_robot, rough):
    smooth, rubbing = rough(), rough(friction=MU, couple=COUPLE)
    for angle in np.linspace(0.0, 0.5, 26):
        stages = START + np.array([0.0, angle, 0.0])
        states = [one.advance(stages, np.zeros(3)) for one in (smooth, rubbing)]
    apart = states[1].wrenches - states[0].wrenches

    # 3 to 8 N mm at each of three places hold the inner tube back, and the tip is millimetres behind
    assert -24e-3 < apart[0, 5] < -9e-3
    assert apart[1, 5] == pytest.approx(-apart[0, 5], rel=0.3)
    assert 0.5e-3 < np.linalg.norm(states[1].truth.tip - states[0].truth.tip) < 5e-3


def test_sliding_takes_the_friction_along_z_and_frees_the_turn(rough):
    plant = rough(friction=MU, couple=COUPLE)
    for angle in np.linspace(0.0, 0.5, 26):
        plant.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))
    before = plant.advance(START + np.array([0.0, 0.5, 0.0]), np.zeros(3)).wrenches[0]
    for slide in np.linspace(0.0, 0.5e-3, 26):
        after = plant.advance(START + np.array([0.0, 0.5, slide]), np.zeros(3)).wrenches[0]

    assert after[2] - before[2] < -9.0  # 3 to 7 N at each of three places
    free = rough()
    torque = free.advance(START + np.array([0.0, 0.5, 0.5e-3]), np.zeros(3)).wrenches[0, 5]
    assert abs(after[5] - torque) < 0.1 * abs(before[5] - torque)


def straight_in_curved() -> Robot:
    """A straight tube in a stiff curved one: without friction every turn of it arrives at its tip."""
    return Robot(
        "windup",
        (
            Tube("inner", (Section(0.30),), 0.04, 0.3, 2.0e-3, 1.2e-3),
            Tube("outer", (Section(0.02), Section(0.13, (4.0, 0.0))), 40.0, 0.3, 2.6e-3, 2.1e-3),
        ),
        (Joint("turn", 0, "rotation"),),
    )


def hold() -> tuple[float, float]:
    """Torque of each of the two places where that outer tube begins and ends to bend the inner one, and GJ."""
    handed = 0.04 * 40.0 / 40.04 * 4.0
    return 2.0 * MU * 1e-3 / COUPLE * handed, 0.04 / 1.3


def test_the_wind_up_is_torque_times_length_by_gj():
    robot = straight_in_curved()
    smooth, rubbing = (
        RoughPlant(robot, BARE.model_copy(update={"friction": mu, "couple": COUPLE}), rng(), np.zeros(1))
        for mu in (0.0, MU)
    )
    for angle in np.linspace(0.0, 1.0, 51):
        states = [one.advance(np.array([angle]), np.zeros(3)) for one in (smooth, rubbing)]
    torque, gj = hold()
    behind = math.atan2(*(smooth.rotation.T @ rubbing.rotation)[[1, 0], [0, 0]])

    assert states[1].wrenches[0, 5] == pytest.approx(-2.0 * torque, rel=1e-3)
    assert behind == pytest.approx(-(torque * 0.02 + torque * 0.15) / gj, rel=0.01)
    assert 1.6 < -math.degrees(behind) < 4.4


def test_what_a_loop_costs_is_what_friction_takes():
    robot = straight_in_curved()
    plant = RoughPlant(robot, BARE.model_copy(update={"friction": MU, "couple": COUPLE}), rng(), np.zeros(1))
    there = np.linspace(-1.0, 1.0, 401)
    for angle in there:
        plant.advance(np.array([angle]), np.zeros(3))
    way = [(np.array([angle]), np.zeros(3)) for angle in (*there[::-1], *there)]
    torque, gj = hold()
    # Each place slides both ways but for its own wind-up there and back.
    slid = [2.0 * (2.0 - 2.0 * behind) for behind in (2.0 * torque * 0.02 / gj, torque * (0.02 + 0.15) / gj)]

    assert work(plant, robot, way) == pytest.approx(torque * sum(slid), rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_friction_never_gives_energy(paper_robot, rough, seed):
    random = rng(seed)
    plant = rough(friction=MU, couple=COUPLE)
    centre, size, phase = random.uniform(-1.0, 1.0, 6), random.uniform(0.1, 1.0, 6), random.uniform(0.0, 6.0, 6)
    reach = np.array([0.5, 0.5, 0.02, 0.2, 0.2, 0.2])

    def at(angle: float) -> tuple[np.ndarray, np.ndarray]:
        both = reach * (0.5 * centre + size * np.sin(angle + phase))
        return START + both[:3], both[3:]

    turns = [at(angle) for angle in np.linspace(0.0, 2.0 * math.pi, 201)]
    work(plant, paper_robot, turns)  # once round, so that the past is the loop's own
    assert work(plant, paper_robot, turns) > 1e-3


@pytest.mark.parametrize("changes", [{}, {"density": 6450.0}], ids=["bare", "heavy"])
def test_without_friction_a_loop_costs_nothing(paper_robot, rough, changes):
    # The innermost tube slides and turns: its own base must have its own share, along z too.
    plant, density = rough(**changes), changes.get("density", 0.0)

    assert abs(work(plant, paper_robot, loop(400), density)) < 1e-8
    assert abs(work(plant, paper_robot, loop(400)[:130], density)) > 1e-3


def test_friction_knows_the_way_and_not_the_time(rough):
    quick, slow = rough(friction=MU, couple=COUPLE), rough(friction=MU, couple=COUPLE)
    angles = 0.3 * np.sin(np.linspace(0.0, 8.0, 200))
    for angle in angles:
        fast = quick.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))
        for _ in range(3):
            late = slow.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))

    assert late.truth.tip == pytest.approx(fast.truth.tip, abs=1e-6)
    assert late.wrenches == pytest.approx(fast.wrenches, abs=1e-5)


def test_the_tip_comes_back_elsewhere(rough):
    plant = rough(friction=MU, couple=COUPLE)
    tips = {}
    for sense in (1.0, -1.0, 1.0):
        for angle in np.linspace(-0.3, 0.3, 61):
            tip = plant.advance(START + np.array([0.0, sense * angle, 0.0]), np.zeros(3)).truth.tip
            if abs(angle) < 1e-9:
                tips[sense] = tip

    # twice a wind-up of two to four degrees at a lever of some 60 mm
    assert 2e-3 < np.linalg.norm(tips[1.0] - tips[-1.0]) < 10e-3


def test_a_straight_tube_hangs_as_a_beam():
    tube = Tube("beam", (Section(0.15),), 0.06, 0.3, 2.0e-3, 1.2e-3)
    robot = Robot("beam", (tube,), (Joint("slide", 0, "translation"),))
    slid = np.array([-0.03])
    plant = RoughPlant(robot, BARE.model_copy(update={"density": 6450.0}), rng(), slid)
    state = plant.advance(slid, np.zeros(3))
    weight = heavy(tube)

    assert weight == pytest.approx(0.127, abs=0.001)
    assert state.truth.tip[0] == pytest.approx(weight * 0.12**4 / (8.0 * 0.06), rel=1e-3)
    # about the sensor, 30 mm behind the plate; what is in the guide hangs there too
    assert state.wrenches[0] == pytest.approx([weight * 0.15, 0.0, 0.0, 0.0, weight * 0.15**2 / 2.0, 0.0], abs=1e-6)


def test_clearance_lets_the_inner_tube_leave_early(paper_robot, rough):
    # As if the outer tube ended half the boundary layer earlier: its curved part d / 2 shorter.
    angle, gap = math.pi / 2, 1e-4
    apart = 4.0 * math.sqrt(2.0)
    early = 0.5 * math.sqrt(6.0 * gap / apart)
    outer = paper_robot.tubes[1]
    shorter = Robot(
        "shorter",
        (
            paper_robot.tubes[0],
            Tube("outer", (Section(0.012), Section(0.153 - early, (4.0, 0.0))), outer.bending_stiffness, 0.3,
                 outer.outer_diameter, outer.inner_diameter),
        ),
        paper_robot.joints,
    )  # fmt: skip
    pose = START + np.array([0.0, angle - START[1], 0.0])
    moved = rough(clearance=gap).advance(pose, np.zeros(3)).truth.tip - rough().advance(pose, np.zeros(3)).truth.tip
    expected = ExactRod(shorter).solve(pose, np.zeros(6)).tip - ExactRod(paper_robot).solve(pose, np.zeros(6)).tip

    assert 0.3e-3 < np.linalg.norm(moved) < 1.5e-3
    assert np.linalg.norm(moved - expected) < 0.2 * np.linalg.norm(expected)


def test_precurvature_walks_as_far_as_said(paper_robot):
    config = BARE.model_copy(update={"walk": 0.02})
    hour, still = [], RoughPlant(paper_robot, BARE, rng(), START).advance(START, np.zeros(3)).truth.tip
    for seed in range(30):
        plant = RoughPlant(paper_robot, config, rng(seed), START)
        assert plant.advance(START, np.zeros(3), now=0.0).truth.tip == pytest.approx(still, abs=1e-7)
        hour.append(np.linalg.norm(plant.advance(START, np.zeros(3), now=3600.0).truth.tip - still))

    # 2 % of what bends the tip away by some 60 mm
    assert 0.5e-3 < float(np.sqrt(np.mean(np.square(hour)))) < 3e-3


def test_a_snap_is_survived(paper_robot):
    plant = RoughPlant(paper_robot, BARE.model_copy(update=EVERYTHING), rng(), START)
    for force in (np.array([3.0, 0.0, 0.0]), np.array([-3.0, 0.0, 0.0]), np.zeros(3)):
        state = plant.advance(START + np.array([0.0, 0.5, 0.0]), force)
        assert np.isfinite(state.truth.tip).all()
        assert np.isfinite(state.wrenches).all()


@pytest.mark.parametrize(
    ("given", "wrong"), [({"friction": 0.2}, "friction"), ({"rod": "rough"}, "friction_force")], ids=str
)
def test_a_number_that_would_do_nothing_is_refused(given, wrong):
    with pytest.raises(ValidationError, match=f"{wrong} belongs to rod"):
        PlantConfig(**given)


def test_the_realistic_lab_rubs_as_tubes_of_this_size_do(paper):
    plant = true_plant(paper.robot(), load_lab("realistic", paper).plant, rng(), START)
    felt = []
    for ways in (np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.0, 0.01])):
        for part in (*np.linspace(0.0, 1.0, 101), *np.linspace(1.0, 0.5, 51)):
            state = plant.advance(START + part * ways, np.zeros(3))
            if abs(part - 0.5) < 1e-9:
                felt.append(state.wrenches[:, [5, 2]])
    (turned, turned_back, slid, slid_back) = felt

    for base in range(2):
        assert 3e-3 < abs(turned[base, 0] - turned_back[base, 0]) / 2.0 < 8.5e-3  # about z [N m]
        assert 3.0 < abs(slid[base, 1] - slid_back[base, 1]) / 2.0 < 8.5  # along z [N]


def test_the_realistic_lab_has_the_rough_one_and_the_gentle_one_today_s(paper):
    start, robot = START, paper.robot()
    plants = {name: true_plant(robot, load_lab(name, paper).plant, rng(), start) for name in ("realistic", "gentle")}

    assert isinstance(plants["realistic"], RoughPlant)
    assert load_lab("default", paper) == load_lab("gentle", paper)
    assert plants["realistic"].robot == plants["gentle"].robot
