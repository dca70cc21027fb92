"""Unknown errors of the virtual lab are zero by default, otherwise have the configured sizes, and follow the seed."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.model.cosserat import ExactRod
from station.config.loads import ContactLoad
from station.config.strict import ConfigError
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import HiddenConfig, LabConfig, load_lab
from station.lab.simulated_bench import SimulatedBench
from station.lab.unmodelled_errors import SENSOR_CENTRE_OF_MASS_M, UnmodelledErrors

START = np.array([0.0, math.pi / 2, -0.100])
ALL = HiddenConfig(
    registration_translation=0.3e-3, registration_rotation=5e-3, coil_offset=(0.4e-3, -0.3e-3, 0.8e-3),
    base_position=1e-3, base_rotation=0.01, rotation_zero=0.02, translation_zero=0.5e-3,
    mirrored=("inner_rotation", "inner_translation"), tracker_latency=0.01, sensor_mounting=0.02, sensor_weight=0.1,
)  # fmt: skip


@pytest.fixture
def hidden(paper):
    return lambda config=ALL, seed=0: UnmodelledErrors(paper, config, np.random.default_rng(seed))


def test_lab_has_no_unknown_errors_by_default(paper, hidden):
    nothing, wrenches = hidden(HiddenConfig()), np.random.default_rng(1).normal(size=(2, 6))

    assert nothing.joints(START) is START
    assert nothing.robot(paper.robot()) == paper.robot()
    np.testing.assert_array_equal(nothing.mount(GENERATOR_POSE).rotation, GENERATOR_POSE.rotation)
    np.testing.assert_array_equal(nothing.mount(GENERATOR_POSE).position, GENERATOR_POSE.position)
    np.testing.assert_array_equal(nothing.coil_axis, [0.0, 0.0, 1.0])
    assert not nothing.changes_wrenches
    np.testing.assert_allclose(nothing.felt(wrenches, START, START), wrenches, atol=1e-15)
    assert nothing.tracker(LabConfig().tracker) == LabConfig().tracker


def test_unknown_errors_have_configured_sizes_and_directions_from_the_seed(hidden):
    first, again, other = hidden(), hidden(), hidden(seed=1)
    for each in (first, other):
        moved = each.mount(GENERATOR_POSE)
        away = Rotation.from_matrix(moved.rotation @ GENERATOR_POSE.rotation.T)
        assert away.magnitude() == pytest.approx(5e-3)
        shift = moved.position - away.apply(GENERATOR_POSE.position)
        assert np.linalg.norm(shift) == pytest.approx(0.3e-3)
    np.testing.assert_array_equal(first.mount(GENERATOR_POSE).rotation, again.mount(GENERATOR_POSE).rotation)
    assert not np.allclose(first.mount(GENERATOR_POSE).rotation, other.mount(GENERATOR_POSE).rotation, atol=1e-5)


def test_mirrored_stage_is_reversed_about_the_middle_of_its_travel(paper, hidden):
    zeros = hidden(ALL.model_copy(update={"rotation_zero": 0.0, "translation_zero": 0.0}))

    np.testing.assert_allclose(zeros.joints(np.array([0.3, 0.5, -0.0675])), [0.3, -0.5, -0.0675], atol=1e-12)
    np.testing.assert_allclose(zeros.joints(np.array([0.3, 0.5, -0.1000])), [0.3, -0.5, -0.0350], atol=1e-12)


def test_errors_of_joint_zeros_are_bounded_and_the_outermost_tube_has_none(hidden):
    config = HiddenConfig(rotation_zero=0.02, translation_zero=0.5e-3)
    zeros = np.array([hidden(config, seed).joints(START) - START for seed in range(50)])

    assert (zeros[:, 0] == 0.0).all()
    assert 0.015 < np.abs(zeros[:, 1]).max() <= 0.02
    assert 0.4e-3 < np.abs(zeros[:, 2]).max() <= 0.5e-3


def test_simulated_base_sensors_measure_their_hanging_weight_and_are_misaligned(hidden):
    found = hidden(HiddenConfig(sensor_mounting=0.02, sensor_weight=0.1))
    felt = found.felt(np.zeros((2, 6)), START, START)

    np.testing.assert_allclose(np.linalg.norm(felt[:, :3], axis=1), [0.1, 0.1], rtol=1e-12)
    inner = Rotation.from_euler("z", -START[1]).apply([0.1, 0.0, 0.0])
    expected = np.r_[inner, np.cross(SENSOR_CENTRE_OF_MASS_M, inner)]
    assert 0.0 < np.abs(felt[0] - expected).max() < 0.021 * 0.1
    assert found.changes_wrenches


def test_wire_lab_rotates_its_plate_and_offsets_its_coil(paper):
    lab = LabConfig(hidden=HiddenConfig(base_rotation=0.05, base_position=2e-3, coil_offset=(0.0, 0.0, 5e-3)))
    bench, plain = (SimulatedBench(paper, config, 3, START, homed=True) for config in (lab, LabConfig()))

    tip = bench.hidden.robot(paper.robot()).base.rotation @ plain.truth.tip
    shift = bench.truth.tip - tip
    assert np.linalg.norm(shift) == pytest.approx(2e-3, rel=1e-3)
    coil = bench._coil_position - bench.truth.tip
    assert np.linalg.norm(coil) == pytest.approx(5e-3)


def test_contact_on_the_shaft_bends_the_true_robot_and_its_moment_is_measured(paper):
    pull = ContactLoad(magnitude=0.3, place=0.1, direction=(0.0, 1.0, 0.0))
    quiet = {"tubes": {}, "poisson_ratio": 0.30, "play": {}, "friction_force": 0.0, "friction_moment": 0.0}
    config = LabConfig(plant=LabConfig().plant.model_copy(update=quiet))
    bench = SimulatedBench(paper, config, 0, START, homed=True)
    bench.apply_load(pull, 0.0)
    for tick in range(1, 4):
        truth = bench.advance(0.002 * tick)

    rod = ExactRod(paper.robot())
    wrench = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    expected = rod.solve(START, wrench, contact=0.1)
    np.testing.assert_allclose(truth.tip, expected.tip, rtol=0, atol=2e-6)
    assert np.linalg.norm(truth.tip - rod.solve(START, wrench).tip) > 5e-3
    outer = bench._wrenches[1]  # alpha = 0 and beta = 0, so this wrench is in the plate's axes
    assert outer[1] == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_allclose(outer[3:5], expected.unknowns[:2], rtol=0, atol=1e-6)


def test_mirrored_joint_that_the_robot_does_not_have_is_refused(paper, write):
    path = write('[hidden]\nmirrored = ["elbow"]\n')

    with pytest.raises(ConfigError, match=r"hidden\.mirrored: 'elbow' is not a joint of robot 'paper'"):
        load_lab(str(path), paper)
