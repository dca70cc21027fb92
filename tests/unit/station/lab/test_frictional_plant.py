"""Tests of the frictional plant: an elastic rod with friction, clearance and weight; each base carries one tube."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from core.control.sensors import fuse
from core.model.cosserat import ExactRod
from core.robot.robot import Joint, Robot, Section, Tube
from station.config.robots import load_robot
from station.lab.config import PlantConfig, load_lab
from station.lab.frictional_plant import STANDARD_GRAVITY, FrictionalPlant, true_plant
from station.lab.plant import Plant
from tests.harness.boundary_value import Point, boundary_value

START = np.array([0.0, math.pi / 2, -0.100])
BARE = PlantConfig(
    rod="rough", tubes={}, poisson_ratio="described", play={}, friction_force=0.0, friction_moment=0.0, step=0.005
)
EVERYTHING = {"friction": 0.15, "clearance": 1e-4, "density": 6450.0}
MU, COUPLE = 0.2, 0.010


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture
def rough(paper_robot):
    """Return a function that creates a frictional plant at the start pose, nominal except for its arguments."""

    def make(**changes: object) -> FrictionalPlant:
        return FrictionalPlant(paper_robot, BARE.model_copy(update=changes), rng(), START)

    return make


#: Slides of the inner tube from the start pose: its end is exposed, passes that of the outer tube, or is inside.
SLIDES = (0.0, -0.038, -0.09)


def loop(points: int = 120, slide: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs of stage positions [rad, rad, m] and tip force [N] along a closed path around a slide [m]."""
    angles = np.linspace(0.0, 2.0 * math.pi, points + 1)
    return [
        (
            START + np.array([0.3 * math.sin(a), 0.4 * (1.0 - math.cos(a)), slide + 0.02 * math.sin(a + 1.0)]),
            np.array([0.2 * math.sin(a), 0.15 * math.cos(a), 0.2 * math.sin(a + 2.0)]),
        )
        for a in angles
    ]


def heavy(tube: Tube, density: float = 6450.0) -> float:
    """Return the weight of a tube [N/m]."""
    return STANDARD_GRAVITY * density * math.pi / 4.0 * (tube.outer_diameter**2 - tube.inner_diameter**2)


def work(
    plant: FrictionalPlant, robot: Robot, path: list[tuple[np.ndarray, np.ndarray]], density: float = 0.0
) -> float:
    """Return the work that the tip load and the stages do on the tubes along a path [J], by the trapezoidal rule.

    Each tube emerges from a guide that is mounted on its base sensor. A bending moment M of the tube at the guide's
    mouth causes an axial force M^2 / (2 EI) between tube and guide. The sensor measures this force, but the stage that
    slides the tube does not carry it. Therefore `work` removes this force from the measured axial force.
    """
    rows = []
    for stages, force in path:
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


@pytest.mark.parametrize("slide", SLIDES)
def test_frictional_plant_without_effects_equals_the_exact_rod(paper_robot, rough, slide):
    plant, exact = rough(), ExactRod(paper_robot)

    for stages, force in loop(40, slide):
        assert plant.advance(stages, force).truth.tip == pytest.approx(
            exact.solve(stages, np.r_[force, 0.0, 0.0, 0.0]).tip, abs=1e-7
        )


@pytest.mark.parametrize("slide", SLIDES)
@pytest.mark.parametrize("changes", [{}, EVERYTHING], ids=str)
def test_base_wrenches_of_the_frictional_plant_add_up_to_load_and_weights(paper_robot, rough, changes, slide):
    # The plant computes each base wrench from one tube alone. Nothing in it makes their sum equal load plus weight.
    plant = rough(**changes)
    weight = sum(heavy(tube, changes.get("density", 0.0)) * tube.length for tube in paper_robot.tubes)

    for stages, force in loop(60, slide):
        state = plant.advance(stages, force)
        load = fuse(state.wrenches, *paper_robot.tube_poses(stages))
        assert load.force == pytest.approx(force + np.array([weight, 0.0, 0.0]), abs=1e-6)
        if not weight:
            assert load.moment == pytest.approx(np.cross(state.truth.tip, force), abs=2e-7)


@pytest.mark.parametrize("kind", [Plant, FrictionalPlant])
@pytest.mark.parametrize("inner", [-0.19, -0.303])  # with the second, the inner tube is flush with the plate
def test_force_beyond_a_retracted_tip_loads_the_base_sensors_with_its_own_lever(paper_robot, kind, inner):
    stages, force, arc = np.array([0.2, 1.4, inner]), np.array([0.1, -0.2, 0.15]), 0.15
    state = kind(paper_robot, BARE, rng(), stages).advance(stages, force, arc)
    truth = boundary_value(paper_robot, stages, np.zeros(6), points=[Point(arc, force)])

    assert state.truth.tip == pytest.approx(truth.tip, abs=1e-7)
    load = fuse(state.wrenches, *paper_robot.tube_poses(stages))
    assert load.force == pytest.approx(force, abs=1e-6)
    assert load.moment == pytest.approx(truth.unknowns[2:], abs=1e-6)


def test_base_wrenches_of_three_frictional_tubes_add_up_to_the_load():
    file = load_robot("three_tubes")
    three_tubes = file.robot()
    config = BARE.model_copy(update=EVERYTHING)
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in file.joints])
    plant = FrictionalPlant(three_tubes, config, rng(), middle)
    weight = sum(heavy(tube) * tube.length for tube in three_tubes.tubes)

    for k in range(40):
        stages = middle + np.array([0.4, 0.3, 0.5, 0.004, 0.006, 0.008]) * math.sin(0.05 * k)
        force = np.array([0.2, -0.1, 0.3]) * math.sin(0.08 * k)
        load = fuse(plant.advance(stages, force).wrenches, *three_tubes.tube_poses(stages))
        assert load.force == pytest.approx(force + np.array([weight, 0.0, 0.0]), abs=1e-6)


def test_friction_between_the_tubes_changes_base_wrenches_and_shape(paper_robot, rough):
    smooth, rubbing = rough(), rough(friction=MU, couple=COUPLE)
    for angle in np.linspace(0.0, 0.5, 26):
        stages = START + np.array([0.0, angle, 0.0])
        states = [one.advance(stages, np.zeros(3)) for one in (smooth, rubbing)]
    apart = states[1].wrenches - states[0].wrenches

    # A friction torque of 3 to 8 N mm at each of three points brakes the inner tube, so the tip lags by millimetres.
    assert -24e-3 < apart[0, 5] < -9e-3
    assert apart[1, 5] == pytest.approx(-apart[0, 5], rel=0.3)
    assert 0.5e-3 < np.linalg.norm(states[1].truth.tip - states[0].truth.tip) < 5e-3


def test_sliding_a_tube_directs_friction_along_z_and_releases_the_wind_up(rough):
    plant = rough(friction=MU, couple=COUPLE)
    for angle in np.linspace(0.0, 0.5, 26):
        plant.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))
    before = plant.advance(START + np.array([0.0, 0.5, 0.0]), np.zeros(3)).wrenches[0]
    for slide in np.linspace(0.0, 0.5e-3, 26):
        after = plant.advance(START + np.array([0.0, 0.5, slide]), np.zeros(3)).wrenches[0]

    assert after[2] - before[2] < -9.0  # friction of 3 to 7 N at each of three points
    free = rough()
    torque = free.advance(START + np.array([0.0, 0.5, 0.5e-3]), np.zeros(3)).wrenches[0, 5]
    assert abs(after[5] - torque) < 0.1 * abs(before[5] - torque)


def straight_in_curved() -> Robot:
    """Return a straight inner tube in a stiff curved outer tube; without friction the inner tube does not twist."""
    return Robot(
        "windup",
        (
            Tube("inner", (Section(0.30),), 0.04, 0.3, 2.0e-3, 1.2e-3),
            Tube("outer", (Section(0.02), Section(0.13, (4.0, 0.0))), 40.0, 0.3, 2.6e-3, 2.1e-3),
        ),
        (Joint("turn", 0, "rotation"),),
    )


def hold() -> tuple[float, float]:
    """Return the friction torque of sliding at one friction point [N m], and GJ of the inner tube [N m^2].

    The robot `straight_in_curved` has two friction points: where the outer tube's curve starts, and where it ends.
    """
    handed = 0.04 * 40.0 / 40.04 * 4.0
    return 2.0 * MU * 1e-3 / COUPLE * handed, 0.04 / 1.3


def test_wind_up_of_a_tube_is_torque_times_length_by_torsional_stiffness():
    robot = straight_in_curved()
    smooth, rubbing = (
        FrictionalPlant(robot, BARE.model_copy(update={"friction": mu, "couple": COUPLE}), rng(), np.zeros(1))
        for mu in (0.0, MU)
    )
    for angle in np.linspace(0.0, 1.0, 51):
        states = [one.advance(np.array([angle]), np.zeros(3)) for one in (smooth, rubbing)]
    torque, gj = hold()
    behind = math.atan2(*(smooth.rotation.T @ rubbing.rotation)[[1, 0], [0, 0]])

    assert states[1].wrenches[0, 5] == pytest.approx(-2.0 * torque, rel=1e-3)
    assert behind == pytest.approx(-(torque * 0.02 + torque * 0.15) / gj, rel=0.01)
    assert 1.6 < -math.degrees(behind) < 4.4


def test_work_around_a_closed_path_equals_the_dissipation_of_friction():
    robot = straight_in_curved()
    plant = FrictionalPlant(robot, BARE.model_copy(update={"friction": MU, "couple": COUPLE}), rng(), np.zeros(1))
    there = np.linspace(-1.0, 1.0, 401)
    for angle in there:
        plant.advance(np.array([angle]), np.zeros(3))
    path = [(np.array([angle]), np.zeros(3)) for angle in (*there[::-1], *there)]
    torque, gj = hold()
    # The joint turns by 2 rad to each side. At a friction point the tube slips by less: after each reversal, the part
    # of the tube between joint and friction point first unwinds and winds up in the new direction.
    slid = [2.0 * (2.0 - 2.0 * behind) for behind in (2.0 * torque * 0.02 / gj, torque * (0.02 + 0.15) / gj)]

    assert work(plant, robot, path) == pytest.approx(torque * sum(slid), rel=0.02)


@pytest.mark.parametrize("seed", range(2))
def test_friction_between_the_tubes_never_generates_energy(paper_robot, rough, seed):
    random = rng(seed)
    plant = rough(friction=MU, couple=COUPLE)
    centre, size, phase = random.uniform(-1.0, 1.0, 6), random.uniform(0.1, 1.0, 6), random.uniform(0.0, 6.0, 6)
    reach = np.array([0.5, 0.5, 0.02, 0.2, 0.2, 0.2])

    def at(angle: float) -> tuple[np.ndarray, np.ndarray]:
        both = reach * (0.5 * centre + size * np.sin(angle + phase))
        return START + both[:3], both[3:]

    turns = [at(angle) for angle in np.linspace(0.0, 2.0 * math.pi, 201)]
    work(plant, paper_robot, turns)  # first round: a further round starts and ends in the same state
    assert work(plant, paper_robot, turns) > 1e-3


@pytest.mark.parametrize("slide", SLIDES)
def test_work_around_a_closed_path_without_friction_is_zero(paper_robot, slide):
    # The innermost tube slides and turns, so the work is zero only if its base carries the correct force along z.
    inner = replace(paper_robot.tubes[0], sections=(Section(0.29), Section(0.013, (4.0, 0.0))))  # straight in the guide
    robot, density = replace(paper_robot, tubes=(inner, paper_robot.tubes[1])), 6450.0
    path = loop(400, slide)
    plant = FrictionalPlant(robot, BARE.model_copy(update={"density": density}), rng(), path[0][0])

    # Where tube ends pass each other, the force along z jumps between two rows of the path.
    assert abs(work(plant, robot, path, density)) < (1e-4 if slide == SLIDES[1] else 2e-8)
    assert max(abs(work(plant, robot, path[:rows], density)) for rows in (50, 100, 250, 300)) > 1e-4


def test_friction_between_the_tubes_depends_on_the_path_and_not_on_time(rough):
    quick, slow = rough(friction=MU, couple=COUPLE), rough(friction=MU, couple=COUPLE)
    angles = 0.3 * np.sin(np.linspace(0.0, 8.0, 200))
    for angle in angles:
        fast = quick.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))
        for _ in range(3):
            late = slow.advance(START + np.array([0.0, angle, 0.0]), np.zeros(3))

    assert late.truth.tip == pytest.approx(fast.truth.tip, abs=1e-6)
    assert late.wrenches == pytest.approx(fast.wrenches, abs=1e-5)


def test_straight_tube_of_the_frictional_plant_sags_like_a_beam():
    tube = Tube("beam", (Section(0.15),), 0.06, 0.3, 2.0e-3, 1.2e-3)
    robot = Robot("beam", (tube,), (Joint("slide", 0, "translation"),))
    slid = np.array([-0.03])
    plant = FrictionalPlant(robot, BARE.model_copy(update={"density": 6450.0}), rng(), slid)
    state = plant.advance(slid, np.zeros(3))
    weight = heavy(tube)

    assert weight == pytest.approx(0.127, abs=0.001)
    assert state.truth.tip[0] == pytest.approx(weight * 0.12**4 / (8.0 * 0.06), rel=1e-3)
    # The moment is about the sensor, 30 mm behind the plate. The sensor also carries the 30 mm of tube in the guide.
    assert state.wrenches[0] == pytest.approx([weight * 0.15, 0.0, 0.0, 0.0, weight * 0.15**2 / 2.0, 0.0], abs=1e-6)


def test_clearance_lets_the_inner_tube_leave_the_outer_one_early(paper_robot, rough):
    # With clearance, the inner tube bends freely over the last length d of the outer tube. The tip is expected to move
    # as if the outer tube's curved section were shorter by d / 2.
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


def test_random_walk_of_the_precurvature_has_the_configured_deviation(paper_robot):
    config = BARE.model_copy(update={"walk": 0.02})
    hour, still = [], FrictionalPlant(paper_robot, BARE, rng(), START).advance(START, np.zeros(3)).truth.tip
    for seed in range(10):
        plant = FrictionalPlant(paper_robot, config, rng(seed), START)
        assert plant.advance(START, np.zeros(3), now=0.0).truth.tip == pytest.approx(still, abs=1e-7)
        hour.append(np.linalg.norm(plant.advance(START, np.zeros(3), now=3600.0).truth.tip - still))

    # The precurvature deflects the tip by about 60 mm. Within an hour the walk changes the precurvature by 2 %
    # (standard deviation), which moves the tip by about 1 mm.
    assert 0.5e-3 < float(np.sqrt(np.mean(np.square(hour)))) < 3e-3


def test_frictional_plant_continues_after_a_snap(paper_robot):
    plant = FrictionalPlant(paper_robot, BARE.model_copy(update=EVERYTHING), rng(), START)
    for force in (np.array([3.0, 0.0, 0.0]), np.array([-3.0, 0.0, 0.0]), np.zeros(3)):
        state = plant.advance(START + np.array([0.0, 0.5, 0.0]), force)
        assert np.isfinite(state.truth.tip).all()
        assert np.isfinite(state.wrenches).all()


@pytest.mark.parametrize(
    ("given", "wrong"), [({"friction": 0.2}, "friction"), ({"rod": "rough"}, "friction_force")], ids=str
)
def test_plant_parameter_that_the_configured_rod_does_not_use_is_refused(given, wrong):
    with pytest.raises(ValidationError, match=f"{wrong}: only rod"):
        PlantConfig(**given)


def test_realistic_lab_has_the_friction_estimated_for_tubes_of_this_size(paper):
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


def test_realistic_lab_has_the_frictional_plant_and_the_gentle_lab_the_smooth_one(paper):
    start, robot = START, paper.robot()
    plants = {name: true_plant(robot, load_lab(name, paper).plant, rng(), start) for name in ("realistic", "gentle")}

    assert isinstance(plants["realistic"], FrictionalPlant)
    assert load_lab("default", paper) == load_lab("gentle", paper)
    assert plants["realistic"].robot == plants["gentle"].robot
