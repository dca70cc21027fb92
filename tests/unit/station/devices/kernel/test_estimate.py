"""The estimate of an axis detects an axis that does not obey, and raises no false alarm."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.devices.kernel.estimate import MAX_UNEXPECTED_READINGS, AxisEstimate

STEP, TRAVEL, TOLERANCE = 0.001, 1e7, 0.012


class Axis:
    """An axis that executes its commands late by up to a tolerance, and its estimate; `obeys` scales its motion."""

    def __init__(self, top: float, seed: int, lost: float = 0.0) -> None:
        self.acceleration = 4.0 * top
        self.estimate = AxisEstimate(top, self.acceleration, TRAVEL, TOLERANCE)
        self.random, self.lost, self.obeys = random.Random(seed), lost, 1.0
        self.now, self.place, self.velocity, self.target = 0.0, 0.5 * TRAVEL, 0.0, 0.0
        self.commands: list[tuple[float, float]] = []
        self.poll_at = self.commanded_at = 0.0
        self.disobeys = False
        for _ in range(2):
            self.estimate.correct(round(self.place))

    def run(self, seconds: float, wanted: float, polls: float = 0.03, commands: float = 0.025) -> float:
        """Command a velocity for a time [s]; return after what time a disobedience was found, or infinity."""
        start = self.now
        while self.now - start < seconds:
            self.now += STEP
            self.estimate.advance(self.now)
            if self.now >= self.commanded_at:
                self.commanded_at = self.now + commands
                self.estimate.command(wanted, self.now)
                self.commands.append((self.now + self.random.uniform(0.0, TOLERANCE), wanted))
            while self.commands and self.commands[0][0] <= self.now:
                self.target = self.commands.pop(0)[1]
            change = self.target - self.velocity
            self.velocity += math.copysign(min(abs(change), self.acceleration * STEP), change)
            self.place += self.obeys * self.velocity * STEP
            if self.now >= self.poll_at:
                self.poll_at = self.now + polls
                self.estimate.expect(self.now)
                self.estimate.advance(self.now)
                if self.random.random() >= self.lost:
                    self.estimate.correct(round(self.place))
                if self.estimate.rejected >= MAX_UNEXPECTED_READINGS:
                    self.disobeys = True
                    return self.now - start
        return math.inf


@settings(max_examples=60, deadline=None)
@given(
    top=st.sampled_from([50.0, 2e3, 1e5]),
    parts=st.lists(st.tuples(st.floats(0.05, 1.5), st.floats(-1.0, 1.0)), min_size=3, max_size=12),
    polls=st.floats(0.004, 0.12),
    lost=st.sampled_from([0.0, 0.3, 0.7]),
    seed=st.integers(0, 10**6),
)
def test_axis_that_obeys_late_is_never_reported(
    top: float, parts: list[tuple[float, float]], polls: float, lost: float, seed: int
) -> None:
    axis = Axis(top, seed, lost)
    for seconds, share in parts:
        axis.run(seconds, share * top, polls)
        assert not axis.disobeys


@pytest.mark.parametrize("obeys", [0.0, -1.0])
@pytest.mark.parametrize("share", [0.1, 1.0])
@pytest.mark.parametrize("top", [2e3, 1e5])
@pytest.mark.parametrize("polls", [0.004, 0.03, 0.1])
def test_axis_that_does_not_obey_is_reported_within_a_second(
    obeys: float, share: float, top: float, polls: float
) -> None:
    axis = Axis(top, 1)
    axis.run(1.0, share * top, polls)
    assert not axis.disobeys
    axis.obeys = obeys
    assert axis.run(2.0, share * top, polls) <= 1.0
    assert ("does not move although" in axis.estimate.disobedience) == (obeys == 0.0)


def test_axis_that_is_not_commanded_to_move_is_never_said_to_stand_still() -> None:
    axis = Axis(1e5, 2)
    axis.run(5.0, 0.0)
    assert not axis.disobeys
    assert "does not move although" not in axis.estimate.disobedience
