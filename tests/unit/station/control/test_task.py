"""Joints that move toward a streamed pose."""

import numpy as np
import pytest

from station.control.task import JOG_TIMEOUT_S, JogMotion

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
