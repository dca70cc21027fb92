"""The smoothed force follows the force; the planned joints match simulated delayed stages."""

import math

import numpy as np
import pytest

from core.control.estimation import Actuation, Estimate, Estimator, estimate
from core.control.observer import Observer, RateFilter
from core.control.tip_force import BANDWIDTH, FORCE, QUALITY, LoadEstimator
from core.errors import DescriptionError
from core.model.solution import pure_force
from core.model.statics import Statics
from station.config.robots import load_robot

PERIOD = 0.002


def test_planned_travel_at_constant_velocity_covers_the_whole_lead_time():
    actuation, sent = Actuation(PERIOD, command_interval=0.025, transport_delay=0.012), np.array([0.1, -0.2, 0.003])
    motion = actuation.start(3)
    for _ in range(20):
        motion = actuation.update(motion, sent)

    assert actuation.lead_time == pytest.approx(0.0245)
    np.testing.assert_allclose(motion.ahead, actuation.lead_time * sent, rtol=1e-12)
    np.testing.assert_allclose(motion.velocity, sent)


@pytest.mark.parametrize("delay", [0, 6])
def test_planned_joint_position_equals_that_of_simulated_delayed_stages(delay):
    """In any sequence of velocities, each velocity moves the joint after the transport delay."""
    random = np.random.default_rng(3)
    actuation = Actuation(PERIOD, command_interval=0.0, transport_delay=delay * PERIOD)
    assert actuation.lead_time == pytest.approx(delay * PERIOD)
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


@pytest.mark.parametrize("bad", [-0.001, 1.5, math.nan])
def test_command_delay_outside_its_bounds_is_refused(bad):
    with pytest.raises(DescriptionError, match=rf"command_interval {bad:g} s is outside 0 \.\.\. 1 s"):
        Actuation(PERIOD, command_interval=bad)
    with pytest.raises(DescriptionError, match=rf"transport_delay {bad:g} s is outside"):
        Actuation(PERIOD, transport_delay=bad)


def smoothing_distances(phase: float, seconds: float) -> tuple[float, float]:
    """Return the largest distances of the smoothed force from the force in the first and in the second half [N].

    The force and the bandwidth of its filter change in step, with a phase between them [rad].
    """
    statics = Statics(load_robot("paper").robot())
    free = statics.solve(np.array([0.0, 0.5 * math.pi, -0.1]), np.zeros(6))
    loaded = statics.solve(free.joints, pure_force(np.array([0.05, 0.0, 0.0])), free)
    estimator = Estimator(
        RateFilter(PERIOD), Observer(PERIOD), Actuation(PERIOD), LoadEstimator(moments=True, adapts=True)
    )
    now = estimator.start(loaded, free, np.array([0.05, 0.0, 0.0]), loaded.tip)
    period, distances = 2.0, []
    for tick in range(round(seconds / PERIOD)):
        angle = 2.0 * math.pi * tick * PERIOD / period
        force = np.array([0.05 + 0.02 * math.sin(angle), 0.0, 0.0])
        numbers = now.numbers.copy()
        last, now = now, Estimate(loaded, free, numbers)
        now.known.load[FORCE] = force
        now.known.load[QUALITY, BANDWIDTH] = 1.0 + 0.5 * math.sin(angle + phase)
        estimate(
            estimator.settings, loaded.numbers, free.numbers, loaded.numbers, free.numbers, last.numbers,
            force, np.zeros(3), np.zeros(3), -1.0, numbers,
        )  # fmt: skip
        distances.append(float(np.linalg.norm(now.known.force_smooth - now.known.force_filtered)))
    np.testing.assert_array_equal(now.force, now.known.load[FORCE])
    first, second = np.array_split(distances, 2)
    return float(first.max()), float(second.max())


def test_smoothed_force_stays_near_the_force_while_bandwidth_and_force_change_in_step() -> None:
    """The distance approaches 0.27 N within minutes; `tests/thorough` checks that it then stays."""
    first, second = smoothing_distances(0.5 * math.pi, 60.0)
    assert 0.0 < first < second < 0.25
