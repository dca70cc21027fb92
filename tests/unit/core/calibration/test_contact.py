"""Contacts on the exact rod found by the model from the moment at the base."""

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.contact import LEAST_FORCE, locate, tip_load
from core.calibration.measurements import Noise
from core.control.force_fusion import Fused
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Section

NOISE = Noise(force=2e-3, moment=0.1e-3)


def felt(robot, joints, force, place, seed=0):
    """Force and moment at the plate of the exact rod, with noise: its own moments there, not r x F."""
    random = np.random.default_rng([seed, 3])
    rod = ExactRod(robot).solve(joints, np.r_[force, np.zeros(3)], contact=place)
    stiffness = [tube.bending_stiffness / tube.stiffness_ratio for tube in robot.tubes]
    moment = np.r_[rod.unknowns[:2], np.dot(stiffness, rod.torsion)]
    return Fused(force + NOISE.force * random.standard_normal(3), moment + NOISE.moment * random.standard_normal(3))


def cases(count):
    random = np.random.default_rng(11)
    for k in range(count):
        joints = np.r_[random.uniform(-3.0, 3.0, 2), random.uniform(-0.12, -0.02)]
        direction = random.standard_normal(3)
        yield k, joints, 0.3 * direction / np.linalg.norm(direction), random.uniform(0.03, 0.303 + joints[2])


def test_contacts_are_found_within_a_few_millimetres_and_inside_their_intervals(paper_robot):
    errors, inside = [], 0
    for seed, joints, force, place in cases(30):
        found = locate(Statics(paper_robot), joints, felt(paper_robot, joints, force, place, seed), NOISE)
        inside += any(start - 0.5e-3 <= place <= end + 0.5e-3 for start, end in found.intervals)
        if found.located:
            errors.append(abs(found.place - place))
    assert len(errors) >= 25
    assert np.median(errors) < 3e-3
    assert max(errors) < 20e-3
    assert inside >= 27


def test_the_point_lies_on_the_loaded_shaft(paper_robot):
    joints, force = np.array([0.3, 1.8, -0.08]), np.array([0.0, 0.3, 0.0])
    model = Statics(paper_robot)
    found = locate(model, joints, felt(paper_robot, joints, force, 0.14), NOISE)
    shape = model.shape(model.solve(joints, np.r_[force, np.zeros(3)], contact=found.place))

    np.testing.assert_allclose(found.point[2], np.interp(found.place, shape[:, 0], shape[:, 12]), rtol=0, atol=0.3e-3)
    assert found.place == pytest.approx(0.14, abs=4e-3)


def test_a_force_along_a_straight_shaft_is_said_not_to_tell(paper_robot):
    straight = [replace(tube, sections=(Section(tube.length),)) for tube in paper_robot.tubes]
    robot = replace(paper_robot, tubes=tuple(straight))
    load = Fused(np.array([0.0, 0.0, -0.3]), np.zeros(3))

    found = locate(Statics(robot), np.array([0.0, 0.0, -0.1]), load, NOISE)

    assert not found.located
    assert "along the shaft" in found.note
    assert found.intervals[0][1] - found.intervals[0][0] > 0.15


def test_no_force_is_no_contact(paper_robot):
    weak = Fused(np.array([0.5 * LEAST_FORCE, 0.0, 0.0]), np.zeros(3))

    assert locate(Statics(paper_robot), np.array([0.0, 1.5, -0.1]), weak, NOISE) is None


def test_the_tip_load_assumption_holds_at_the_tip_and_is_flagged_elsewhere(paper_robot):
    model, flagged, kept = Statics(paper_robot), 0, 0
    for seed, joints, force, place in cases(30):
        tip = model.solve(joints, np.r_[force, np.zeros(3)]).tip
        kept += tip_load(felt(paper_robot, joints, force, None, seed), tip, NOISE).holds
        tip = model.solve(joints, np.r_[force, np.zeros(3)], contact=0.5 * place).tip
        flagged += not tip_load(felt(paper_robot, joints, force, 0.5 * place, seed), tip, NOISE).holds
    assert kept == 30
    assert flagged >= 28
