"""Joints that move toward a streamed pose; readings of a robot at rest and of one that is touched."""

import numpy as np
import pytest

from station.control.task import JOG_TIMEOUT_S, JogMotion, SettlePhase
from station.devices.interfaces import WrenchReading

TOP, PERIOD = np.array([0.5, 0.02]), 0.002


def test_joints_go_straight_to_a_streamed_pose_at_most_at_their_top_speed_and_stop_without_renewal():
    start, goal = np.array([0.3, -0.10]), np.array([-0.2, -0.095])
    motion, joints, now = JogMotion("pose", goal, 0.0, None), start, 0.0
    path = [start]
    while now < 3.0:
        assert motion.renew("pose", goal, now)
        velocity = motion.order(now, PERIOD, joints, TOP).velocity
        assert (np.abs(velocity) <= TOP * (1.0 + 1e-12)).all()
        joints, now = joints + PERIOD * velocity, now + PERIOD
        path.append(joints)
    shares = (np.array(path) - start) / (goal - start)
    assert shares[:, 0] == pytest.approx(shares[:, 1], abs=1e-9)
    assert (np.diff(shares[:, 0]) >= 0.0).all()  # no overshoot
    assert shares[-1] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert motion.order(now + 0.9 * JOG_TIMEOUT_S, PERIOD, joints, TOP) is not None
    assert motion.order(now + JOG_TIMEOUT_S, PERIOD, joints, TOP) is None
    assert not motion.renew("joints", TOP, now)  # the loop refuses another kind of motion meanwhile


def rested(touch: float = 0.0, *, late: int = 1, seed: int = 0) -> SettlePhase:
    """Readings of two sensors for 1.5 s, of which each is read `late` times; a touch lasts for a third of the time."""
    random, rest, wrench = np.random.default_rng(seed), SettlePhase(0.0), np.zeros((2, 6))
    for tick in range(750):
        if tick % late == 0:
            wrench = random.normal(size=(2, 6)) * ((0.02,) * 3 + (2e-4,) * 3)
            wrench[0, 0] += touch * (200 <= tick < 450)
        reading = WrenchReading(0.002 * (tick - tick % late), wrench)
        rest.take(reading, random.normal(size=3) * 1e-4 if tick % 13 == 0 else None)
    return rest


@pytest.mark.parametrize("late", [1, 5, 60, 150, 200])
def test_noise_is_no_change_at_rest_however_rarely_a_sample_arrives(late):
    assert [rested(late=late, seed=seed).unrest for seed in range(40)] == [""] * 40


@pytest.mark.parametrize(("touch", "late"), [(0.03, 1), (0.06, 5), (0.3, 30)])
def test_a_touch_is_a_change(touch, late):
    for seed in range(20):
        assert rested(touch, late=late, seed=seed).unrest.startswith("the robot was not at rest: the force on a sensor")
