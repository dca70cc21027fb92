from typing import Any

import numpy as np
import pytest

from station.config.strict import ConfigError, check
from station.lab.config import LabConfig, TargetConfig
from station.lab.simulated_bench import MovingTarget

TIP = np.array([0.01, 0.02, 0.15])
TIMES = np.arange(0.0, 240.0, 0.05)


def displacements(seed: int = 0, **changes: Any) -> np.ndarray:
    """Return displacements (times, 3) from the target's middle [m]."""
    target = MovingTarget(TargetConfig(**changes), TIP, np.random.default_rng(seed))
    return np.array([target.at(time) for time in TIMES]) - TIP - np.array(TargetConfig().place)


def beats(along: np.ndarray) -> float:
    """Return the rate [Hz] from the number of upward crossings."""
    return float(np.count_nonzero((along[:-1] < 0.0) & (along[1:] >= 0.0))) / TIMES[-1]


def test_moving_target_breathes_along_a_line_from_the_seed():
    moved = displacements(heartbeat=0.0, breathing_second=0.0)
    _, sizes, lines = np.linalg.svd(moved, full_matrices=False)

    assert sizes[1] < 1e-9 * sizes[0]
    along = moved @ lines[0]
    assert np.abs(along).max() == pytest.approx(5e-3 * 1.1, rel=0.01)  # the amplitude drifts by up to a tenth
    assert beats(along) == pytest.approx(0.25, abs=0.01)
    assert abs(lines[0] @ np.linalg.svd(displacements(10)[:200])[2][0]) < 0.999


def test_heartbeat_moves_the_target_along_a_second_line():
    moved = displacements(breathing=0.0)
    line = np.linalg.svd(moved, full_matrices=False)[2][0]

    assert np.abs(moved @ line).max() == pytest.approx(0.55e-3, rel=0.01)
    assert beats(moved @ line) == pytest.approx(1.2, abs=0.03)


def test_rate_of_the_moving_target_drifts_by_the_configured_fraction():
    moved = displacements(heartbeat=0.0, breathing_second=0.0, size_drift=0.0)
    along = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    up = TIMES[:-1][(along[:-1] < 0.0) & (along[1:] >= 0.0)]
    rates = 1.0 / np.diff(up)

    assert rates.max() == pytest.approx(0.25 * 1.05, rel=0.01)
    assert rates.min() == pytest.approx(0.25 * 0.95, rel=0.01)


def test_moving_target_is_refused_with_ideal_devices():
    with pytest.raises(ConfigError, match="target: ideal devices have no second coil"):
        check(LabConfig, {"devices": "ideal", "target": {}}, "lab")
