"""The model locates contacts on the exact rod from the moment at the base."""

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.contact import MIN_FORCE_N, evaluate_tip_load, locate_contact
from core.calibration.measurements import Noise
from core.control.sensors import FusedLoad
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Section

NOISE = Noise(force=2e-3, moment=0.1e-3)


def felt(robot, joints, force, s, seed=0):
    """Return force and moment at the plate with noise; the moment is the exact rod's internal one, not r x F."""
    random = np.random.default_rng([seed, 3])
    rod = ExactRod(robot).solve(joints, np.r_[force, np.zeros(3)], contact=s)
    stiffness = [tube.bending_stiffness / tube.stiffness_ratio for tube in robot.tubes]
    moment = np.r_[rod.unknowns[:2], np.dot(stiffness, rod.torsion)]
    return FusedLoad(force + NOISE.force * random.standard_normal(3), moment + NOISE.moment * random.standard_normal(3))


def cases(count):
    random = np.random.default_rng(11)
    for k in range(count):
        joints = np.r_[random.uniform(-3.0, 3.0, 2), random.uniform(-0.12, -0.02)]
        direction = random.standard_normal(3)
        yield k, joints, 0.3 * direction / np.linalg.norm(direction), random.uniform(0.03, 0.303 + joints[2])


def test_contacts_are_located_within_millimetres_and_inside_their_intervals(paper_robot):
    errors, inside = [], 0
    for seed, joints, force, s in cases(12):
        found = locate_contact(Statics(paper_robot), joints, felt(paper_robot, joints, force, s, seed), NOISE)
        inside += any(start - 0.5e-3 <= s <= end + 0.5e-3 for start, end in found.intervals)
        if found.located:
            errors.append(abs(found.arc_length - s))
    assert len(errors) >= 10
    assert np.median(errors) < 3e-3
    assert max(errors) < 20e-3
    assert inside >= 11


@pytest.mark.parametrize("s", [0.06, 0.12, 0.15])
def test_contact_on_the_outer_tube_beyond_a_retracted_tip_is_located(paper_robot, s):
    joints, force = np.array([0.3, 1.8, -0.2]), np.array([0.2, 0.2, 0.0])
    assert paper_robot.tube_ends(joints) == pytest.approx([0.103, 0.165])
    found = locate_contact(Statics(paper_robot), joints, felt(paper_robot, joints, force, s), NOISE)
    assert found.located
    assert found.arc_length == pytest.approx(s, abs=4e-3)


def test_the_contact_point_is_on_the_loaded_shaft(paper_robot):
    joints, force = np.array([0.3, 1.8, -0.08]), np.array([0.0, 0.3, 0.0])
    model = Statics(paper_robot)
    found = locate_contact(model, joints, felt(paper_robot, joints, force, 0.14), NOISE)
    shape = model.shape(model.solve(joints, np.r_[force, np.zeros(3)], contact=found.arc_length))

    np.testing.assert_allclose(
        found.point[2], np.interp(found.arc_length, shape[:, 0], shape[:, 12]), rtol=0, atol=0.3e-3
    )
    assert found.arc_length == pytest.approx(0.14, abs=4e-3)


def test_a_force_along_a_straight_shaft_is_reported_as_not_located(paper_robot):
    straight = [replace(tube, sections=(Section(tube.length),)) for tube in paper_robot.tubes]
    robot = replace(paper_robot, tubes=tuple(straight))
    load = FusedLoad(np.array([0.0, 0.0, -0.3]), np.zeros(3))

    found = locate_contact(Statics(robot), np.array([0.0, 0.0, -0.1]), load, NOISE)

    assert not found.located
    assert "along the shaft" in found.note
    assert found.intervals[0][1] - found.intervals[0][0] > 0.15


def test_a_force_below_the_threshold_gives_no_contact(paper_robot):
    weak = FusedLoad(np.array([0.5 * MIN_FORCE_N, 0.0, 0.0]), np.zeros(3))

    assert locate_contact(Statics(paper_robot), np.array([0.0, 1.5, -0.1]), weak, NOISE) is None


def test_the_tip_load_test_accepts_tip_loads_and_rejects_shaft_loads(paper_robot):
    model, flagged, kept = Statics(paper_robot), 0, 0
    for seed, joints, force, s in cases(12):
        tip = model.solve(joints, np.r_[force, np.zeros(3)]).tip
        kept += evaluate_tip_load(felt(paper_robot, joints, force, None, seed), tip, NOISE).accepted
        tip = model.solve(joints, np.r_[force, np.zeros(3)], contact=0.5 * s).tip
        flagged += not evaluate_tip_load(felt(paper_robot, joints, force, 0.5 * s, seed), tip, NOISE).accepted
    assert kept == 12
    assert flagged >= 11
