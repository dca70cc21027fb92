"""Commands that work later and are held: the plan against stages simulated by small steps."""

import math

import numpy as np
import pytest

from core.control.actuation import Actuation
from core.errors import DescriptionError

PERIOD = 0.002


def test_at_rest_nothing_is_ahead():
    actuation = Actuation(PERIOD)

    motion = actuation.update(actuation.start(3), np.zeros(3))

    assert not motion.velocity.any()
    assert not motion.ahead.any()


def test_a_constant_velocity_will_have_covered_the_whole_lead():
    actuation, sent = Actuation(PERIOD, hold=0.025, transport=0.012), np.array([0.1, -0.2, 0.003])
    motion = actuation.start(3)
    for _ in range(20):
        motion = actuation.update(motion, sent)

    assert actuation.lead == pytest.approx(0.0245)
    np.testing.assert_allclose(motion.ahead, actuation.lead * sent, rtol=1e-12)
    np.testing.assert_allclose(motion.velocity, sent)


def test_the_plan_is_where_stages_with_that_delay_really_are():
    """Any sequence of velocities: the joint moves by each a transport later."""
    random = np.random.default_rng(3)
    actuation = Actuation(PERIOD, hold=0.0, transport=0.012)
    delay = 6
    sent = random.normal(size=(60, 2))
    motion, position, positions, plans = actuation.start(2), np.zeros(2), [], []
    for tick in range(60):
        positions.append(position.copy())
        motion = actuation.update(motion, sent[tick - 1] if tick else np.zeros(2))
        # What is sent at a tick works from `delay` ticks later on.
        works, worked = (sent[tick - late] if tick >= late else np.zeros(2) for late in (delay, delay + 1))
        np.testing.assert_allclose(motion.velocity, worked)
        plans.append(position + motion.ahead)
        position = position + PERIOD * works

    for tick in range(60 - delay):
        # What was sent before this tick has all worked `delay` ticks on.
        np.testing.assert_allclose(plans[tick], positions[tick + delay], rtol=0, atol=1e-12)


def test_without_delay_the_joints_do_at_once_what_is_sent():
    actuation = Actuation(PERIOD, 0.0, 0.0)

    motion = actuation.update(actuation.start(1), np.array([0.5]))

    assert motion.velocity.tolist() == [0.5]
    assert motion.ahead.tolist() == [0.0]
    assert actuation.lead == 0.0


@pytest.mark.parametrize("bad", [-0.001, 1.5, math.nan])
def test_a_delay_that_is_none_is_refused(bad):
    with pytest.raises(DescriptionError, match=rf"hold {bad:g} s is outside 0 \.\.\. 1 s"):
        Actuation(PERIOD, hold=bad)
    with pytest.raises(DescriptionError, match=rf"transport {bad:g} s is outside"):
        Actuation(PERIOD, transport=bad)
