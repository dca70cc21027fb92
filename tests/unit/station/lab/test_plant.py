"""The smooth plant: an exact rod with true parameters, play of the drives, friction and base wrenches."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.control.sensors import fuse
from core.model.cosserat import ExactRod
from core.robot.robot import Joint, Robot, Section, Tube
from station.lab.config import PlantConfig
from station.lab.plant import Plant, PlantState, true_robot

START = np.array([0.0, math.pi / 2, -0.100])
NOMINAL = PlantConfig(tubes={}, poisson_ratio="described", play={}, friction_force=0.0, friction_moment=0.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture
def plant(paper_robot):
    """Return a function that creates a plant at the start pose, nominal except for its arguments."""

    def make(**changes: object) -> Plant:
        return Plant(paper_robot, NOMINAL.model_copy(update=changes), rng(), START)

    return make


def moved(*by: float) -> np.ndarray:
    """Return the start pose with every joint moved."""
    return START + np.array(by)


def walk(seed: int, steps: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return stage positions and tip forces of up to 0.5 N, with every joint moving back and forth."""
    random = rng(seed)
    phase = random.uniform(0.0, 2.0 * math.pi, 6)
    return [
        (
            START + np.array([0.3, 0.3, 0.02]) * np.sin(0.1 * k + phase[:3]),
            0.5 / math.sqrt(3.0) * np.sin(0.07 * k + phase[3:]),
        )
        for k in range(steps)
    ]


def to_world(state: PlantState, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Return each tube's base wrench (q, 6) in world axes about the plate's origin, by rotation matrices."""
    rows = []
    for wrench, angle, place in zip(state.wrenches, alpha, beta, strict=True):
        turn = Rotation.from_euler("z", angle)
        force = turn.apply(wrench[:3])
        rows.append(np.r_[force, turn.apply(wrench[3:]) + np.cross([0.0, 0.0, place], force)])
    return np.array(rows)


def test_default_plant_differs_from_the_model_by_the_documented_errors(paper_robot):
    inner, outer = true_robot(paper_robot, PlantConfig(), rng()).tubes

    assert inner.bending_stiffness == pytest.approx(0.95 * 0.0413)
    assert inner.sections[1].curvature == pytest.approx((0.97 * 4.0, 0.0))
    assert outer.bending_stiffness == pytest.approx(1.04 * 0.0480)
    assert outer.sections[1].curvature == pytest.approx((1.02 * 4.0, 0.0))
    assert (inner.poisson_ratio, outer.poisson_ratio) == (0.35, 0.35)
    assert [section.length for section in inner.sections] == [0.150, 0.153]


def test_described_plant_has_poissons_ratio_of_the_robot_file(paper_robot):
    own = replace(paper_robot, tubes=(replace(paper_robot.tubes[0], poisson_ratio=0.42), paper_robot.tubes[1]))

    assert [tube.poisson_ratio for tube in true_robot(own, NOMINAL, rng()).tubes] == [0.42, 0.30]


def test_key_vary_draws_tube_errors_uniformly_inside_its_range(paper_robot):
    config = PlantConfig(vary=0.08)
    drawn = np.array([
        [(tube.bending_stiffness / nominal.bending_stiffness - 1.0, tube.sections[1].curvature[0] / 4.0 - 1.0)
         for tube, nominal in zip(true_robot(paper_robot, config, rng(seed)).tubes, paper_robot.tubes, strict=True)]
        for seed in range(200)
    ]).reshape(200, 4)  # fmt: skip

    assert np.abs(drawn).max() <= 0.08
    assert (drawn.max(axis=0) > 0.07).all()
    assert (drawn.min(axis=0) < -0.07).all()
    # The four errors are uniform within +-0.08, which has a deviation of 0.08 / sqrt(3), and are not correlated.
    assert drawn.std(axis=0) == pytest.approx(np.full(4, 0.08 / math.sqrt(3.0)), rel=0.1)
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 0.2


def test_plant_with_nominal_parameters_equals_the_exact_rod(paper_robot, plant):
    nominal, exact = plant(), ExactRod(paper_robot)

    for stages, force in walk(1, 60):
        true = nominal.advance(stages, force).truth
        # The plant has coarser steps and tolerances than the reference, so they differ by up to 0.1 um.
        assert true.tip == pytest.approx(exact.solve(stages, np.r_[force, 0.0, 0.0, 0.0]).tip, abs=1e-7)
        assert true.force == pytest.approx(force)


@pytest.mark.parametrize("friction", [0.0, 10.0])
def test_base_wrenches_of_the_smooth_plant_add_up_to_the_tip_load(paper_robot, plant, friction):
    rubbing = plant(friction_force=0.05 * friction, friction_moment=0.5e-3 * friction)

    for stages, force in walk(2, 60):
        state = rubbing.advance(stages, force)
        load = fuse(state.wrenches, *paper_robot.tube_poses(stages))
        assert load.force == pytest.approx(force, abs=1e-14)
        assert load.moment == pytest.approx(np.cross(state.truth.tip, force), abs=1e-14)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize(("joint", "distance", "component", "most"), [(2, 1e-3, 2, 0.05), (1, 0.1, 5, 0.5e-3)])
def test_friction_loads_the_two_base_sensors_with_opposite_signs(
    paper_robot, plant, joint, distance, component, most, sense
):
    rubbing, smooth = plant(friction_force=0.05, friction_moment=0.5e-3), plant()
    stages, force = START.copy(), np.array([0.2, 0.0, 0.1])
    stages[joint] += sense * distance

    felt = [to_world(one.advance(stages, force), *paper_robot.tube_poses(stages)) for one in (rubbing, smooth)]

    # The inner tube moves: friction at the outer tube brakes it and pulls the outer tube along.
    inner = np.zeros(6)
    inner[component] = -sense * most
    assert felt[0] - felt[1] == pytest.approx(np.array([inner, -inner]), abs=1e-12)


def test_friction_acts_between_neighbouring_tubes_only():
    tubes = (
        Tube("a", (Section(0.20), Section(0.10, (6.0, 0.0))), 0.02, 0.30, 1.0e-3, 0.5e-3),
        Tube("b", (Section(0.10), Section(0.10, (3.0, 2.0))), 0.04, 0.35, 1.8e-3, 1.2e-3),
        Tube("c", (Section(0.03), Section(0.08, (2.0, 0.0))), 0.09, 0.25, 2.6e-3, 2.0e-3),
    )
    robot = Robot("three", tubes, (Joint("slide", 0, "translation"), Joint("turn", 1, "rotation")))
    rough = NOMINAL.model_copy(update={"friction_force": 0.05, "friction_moment": 0.5e-3})
    start = np.array([-0.05, 0.3])

    def friction(slide: float, turn: float) -> np.ndarray:
        felt = []
        for config in (rough, NOMINAL):
            stages = start + np.array([slide, turn])
            state = Plant(robot, config, rng(), start).advance(stages, np.array([0.1, 0.0, 0.0]))
            felt.append(to_world(state, *robot.tube_poses(stages)))
        return felt[0] - felt[1]

    # The innermost tube slides forward: friction pulls its neighbour along, and no friction acts on the outermost tube.
    assert friction(0.001, 0.0)[:, 2] == pytest.approx([-0.05, 0.05, 0.0], abs=1e-12)
    # The middle tube turns: friction at both neighbours brakes it.
    assert friction(0.0, 0.1)[:, 5] == pytest.approx([0.5e-3, -1.0e-3, 0.5e-3], abs=1e-12)


def test_friction_of_the_smooth_plant_rises_linearly_over_the_stick_zone(plant):
    rubbing, smooth = plant(friction_force=0.05), plant()
    force = np.zeros(3)

    def axial(stages: np.ndarray) -> float:
        return float(rubbing.advance(stages, force).wrenches[0, 2] - smooth.advance(stages, force).wrenches[0, 2])

    # Friction reaches 0.05 N after 20 um and half of it after 10 um; it reverses over 40 um.
    assert axial(moved(0.0, 0.0, 10e-6)) == pytest.approx(-0.025)
    assert axial(moved(0.0, 0.0, 500e-6)) == pytest.approx(-0.050)
    assert axial(moved(0.0, 0.0, 490e-6)) == pytest.approx(-0.025)
    assert axial(moved(0.0, 0.0, 480e-6)) == pytest.approx(0.0, abs=1e-12)
    assert axial(moved(0.0, 0.0, 460e-6)) == pytest.approx(0.050)


def test_inner_tube_does_not_move_within_the_play_of_its_drive_after_a_reversal(plant):
    loose, tight = plant(play={"inner_rotation": math.radians(0.1)}), plant()

    def tip(one: Plant, degrees: float) -> np.ndarray:
        return one.advance(moved(0.0, math.radians(degrees), 0.0), np.array([0.2, 0.0, 0.0])).truth.tip

    tip(loose, 1.0)
    ahead = tip(loose, 2.0)
    # The drive pushes the tube from behind, so the tube lags by half the play.
    assert ahead == pytest.approx(tip(tight, 1.95), abs=1e-7)
    for degrees in (1.99, 1.95, 1.901):
        assert tip(loose, degrees) == pytest.approx(ahead, abs=1e-7)
    assert tip(loose, 1.5) == pytest.approx(tip(tight, 1.55), abs=1e-7)
    assert tip(loose, 1.599) == pytest.approx(tip(tight, 1.55), abs=1e-7)
    assert tip(loose, 1.7) == pytest.approx(tip(tight, 1.65), abs=1e-7)
    # The effect of the play is large enough to be tested: 0.1 deg moves the tip by 40 um.
    assert np.linalg.norm(tip(tight, 2.0) - tip(tight, 1.9)) > 20e-6


def test_play_of_a_drive_affects_only_its_joint(plant):
    loose, tight = plant(play={"inner_rotation": math.radians(0.1)}), plant()

    for stages in ([0.1, 0.0, 0.0], [0.05, 0.0, 0.001], [0.1, 0.0, -0.001]):
        tips = [one.advance(START + stages, np.zeros(3)).truth.tip for one in (loose, tight)]
        assert tips[0] == pytest.approx(tips[1], abs=1e-7)
