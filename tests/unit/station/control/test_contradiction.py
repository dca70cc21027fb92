"""The monitor names the tracker or the force sensors if both contradict each other, and nothing else."""

import numpy as np
import pytest

from station.control.contradiction import FRAMES, ComparedTips, ContradictionMonitor
from station.control.monitors import Margins

INTERVAL_S, NOISE_M = 0.025, 1e-4
X = np.array([1.0, 0.0, 0.0])


class Bench:
    """A tip whose parts a test moves, and the monitor."""

    def __init__(self, *, unexplained: float = Margins().unexplained) -> None:
        self.monitor, self.now = ContradictionMonitor(unexplained), 1.0

    def frame(
        self,
        tracker: float = 0.0,
        free: float = 0.0,
        bent: float = 0.0,
        path: float = 0.0,
        *,
        readings: float = 0.0,
        at_tip: bool = True,
    ) -> str:
        """Return what the monitor says to a frame; the arguments are displacements along x [m]."""
        self.now += INTERVAL_S
        tips = ComparedTips(
            tracker * X,
            (free + bent) * X,
            free * X,
            path * X,
            0.1 * X,
            readings * np.ones((4, 3)),
            0.01,
            at_tip,
            NOISE_M,
        )
        return self.monitor.check(tips, self.now, INTERVAL_S)

    def frames(self, count: int, **moved: float) -> str:
        return next(filter(None, [self.frame(**moved) for _ in range(count)]), "")


def test_a_displaced_tracker_is_named_with_both_values() -> None:
    bench = Bench()
    assert not bench.frames(40)
    assert not bench.frames(FRAMES // 2, tracker=0.004)
    cause = bench.frame(tracker=0.004)
    assert cause.startswith("the tracker contradicts stages and force sensors")
    assert "4 mm" in cause
    assert "0.1 N" in cause
    assert "1.8 mm" in cause
    assert "metal near the tracker" in cause


def test_a_wrong_force_is_named() -> None:
    bench = Bench()
    bench.frames(40)
    assert bench.frames(10, bent=0.004).startswith("the force sensors contradict the tracker")


@pytest.mark.parametrize(
    "moved",
    [
        {"tracker": 0.0015},
        {"tracker": 0.020, "bent": 0.017},  # a load on softer tubes
        {"tracker": 0.020, "free": 0.0175, "path": 0.020},  # a path of a robot that is not calibrated
        {"tracker": 0.005, "bent": 0.015, "at_tip": False},
        {"tracker": 0.0025, "readings": 0.2},  # errors of gain after a change of the readings by a fifth of the range
    ],
)
def test_errors_of_the_tubes_and_loads_are_no_contradiction(moved) -> None:
    bench = Bench()
    assert not bench.frames(40)
    assert not bench.frames(200, **moved)
    assert not bench.frames(200)


@pytest.mark.parametrize("speed", [2e-4, 5e-4, 2e-3])
def test_a_slow_displacement_adds_up(speed) -> None:
    bench = Bench()
    bench.frames(40)
    moved = 0.0
    while not bench.frame(tracker=moved):
        moved += speed * INTERVAL_S
        assert moved < 0.0025


def test_the_delay_of_the_frames_is_no_contradiction() -> None:
    bench = Bench()
    bench.frames(40)
    tips = np.cumsum([0.1 * INTERVAL_S] * 40)  # 0.1 m/s by a load
    assert not any(bench.frame(tracker=last, bent=tip) for last, tip in zip((0.0, *tips), tips, strict=False))


def test_more_noise_is_no_contradiction() -> None:
    bench, random = Bench(), np.random.default_rng(1)
    assert not any(bench.frame(tracker=2e-3 * random.normal()) for _ in range(400))


def test_tips_that_cannot_be_compared_and_a_larger_limit_end_nothing() -> None:
    bench = Bench(unexplained=0.01)
    bench.frames(40)
    assert not bench.frames(40, tracker=0.01)
    assert not any(bench.monitor.check(None, bench.now, INTERVAL_S) for _ in range(40))
