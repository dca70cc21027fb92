"""Delayed, sampled-and-held commands: the plan compared with stages simulated in small steps."""

import math

import numpy as np
import pytest

from core.control.actuation import Actuation
from core.errors import DescriptionError

PERIOD = 0.002


def test_planned_joint_travel_is_zero_at_rest():
    actuation = Actuation(PERIOD)

    motion = actuation.update(actuation.start(3), np.zeros(3))

    assert not motion.velocity.any()
    assert not motion.ahead.any()


def test_planned_travel_at_constant_velocity_covers_the_whole_lead_time():
    actuation, sent = Actuation(PERIOD, command_interval=0.025, transport_delay=0.012), np.array([0.1, -0.2, 0.003])
    motion = actuation.start(3)
    for _ in range(20):
        motion = actuation.update(motion, sent)

    assert actuation.lead_time == pytest.approx(0.0245)
    np.testing.assert_allclose(motion.ahead, actuation.lead_time * sent, rtol=1e-12)
    np.testing.assert_allclose(motion.velocity, sent)


def test_planned_joint_position_equals_that_of_simulated_delayed_stages():
    """In any sequence of velocities, each velocity moves the joint after the transport delay."""
    random = np.random.default_rng(3)
    actuation = Actuation(PERIOD, command_interval=0.0, transport_delay=0.012)
    delay = 6
    sent = random.normal(size=(60, 2))
    motion, position, positions, plans = actuation.start(2), np.zeros(2), [], []
    for tick in range(60):
        positions.append(position.copy())
        motion = actuation.update(motion, sent[tick - 1] if tick else np.zeros(2))
        # A command sent at a tick takes effect `delay` ticks later.
        works, worked = (sent[tick - late] if tick >= late else np.zeros(2) for late in (delay, delay + 1))
        np.testing.assert_allclose(motion.velocity, worked)
        plans.append(position + motion.ahead)
        position = position + PERIOD * works

    for tick in range(60 - delay):
        # After `delay` ticks all commands sent before this tick have taken effect.
        np.testing.assert_allclose(plans[tick], positions[tick + delay], rtol=0, atol=1e-12)


def test_planned_joints_move_at_once_when_the_stages_have_no_delay():
    actuation = Actuation(PERIOD, 0.0, 0.0)

    motion = actuation.update(actuation.start(1), np.array([0.5]))

    assert motion.velocity.tolist() == [0.5]
    assert motion.ahead.tolist() == [0.0]
    assert actuation.lead_time == 0.0


@pytest.mark.parametrize("bad", [-0.001, 1.5, math.nan])
def test_command_delay_outside_its_bounds_is_refused(bad):
    with pytest.raises(DescriptionError, match=rf"command_interval {bad:g} s is outside 0 \.\.\. 1 s"):
        Actuation(PERIOD, command_interval=bad)
    with pytest.raises(DescriptionError, match=rf"transport_delay {bad:g} s is outside"):
        Actuation(PERIOD, transport_delay=bad)
