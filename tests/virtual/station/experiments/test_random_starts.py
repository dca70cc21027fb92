"""Random start poses: near a fold of the robot's solutions, at the fold, and where the tip cannot be held."""

import json
import math

import numpy as np
import pytest

from tests.harness.cases import a_case, a_run
from tests.measure.starts import PEAK_FORCES_N, RandomStart, StartOutcome, draw, prepare_case, reference_error, summary

PEAK = PEAK_FORCES_N["fig8"]


@pytest.fixture(scope="module")
def case():
    return a_case("fig8", "regulation", duration=20.0)


def test_seed_reproduces_a_start_from_the_whole_travel(case):
    starts = np.array([draw(seed, case, PEAK).joints for seed in range(300)])

    assert draw(7, case, PEAK).joints.tolist() == starts[7].tolist()
    assert (np.abs(starts[:, :2]) <= math.pi).all()
    assert starts[:, 2].min() == pytest.approx(-0.125, abs=1e-3)
    assert starts[:, 2].max() == pytest.approx(-0.010, abs=1e-3)
    assert np.linalg.norm(draw(7, case, PEAK).direction) == pytest.approx(1.0)


def test_no_joint_spins_when_the_tip_is_held_at_a_singular_pose(case):
    check_rotations(case, 0.0, (0.0, 1.0, 0.0), PEAK)


def check_rotations(case, apart, direction, peak):
    """Check the rotations from a start pose whose tubes bend in directions that are `apart` [rad], under a load."""
    start = RandomStart(np.array([0.3, 0.3 + apart, -0.06]), direction, peak)
    recording = a_run(prepare_case(case, start), 3)
    channels, rows = recording.channels, recording.rows
    away = np.linalg.norm(channels.of(rows, "tip_true") - channels.of(rows, "tip_desired"), axis=1)
    moved = np.abs(np.diff(channels.of(rows, "joints"), axis=0)).sum(axis=0)

    if recording.completed:
        # The tip drifts along the singular direction, by the noise of the sensors: 0.5 to 1.4 mm over seeds 3 to 6.
        assert away[-500:].max() < 2e-3
    else:
        assert "singular pose" in recording.cause
        assert "travel" in recording.cause or "sigma" in recording.cause
    # The distance with the controller must be at most 10 % larger than the deflection by the load without a controller.
    statics = case.controller.statics
    bent = statics.solve(start.joints, np.r_[peak * np.array(direction) / np.linalg.norm(direction), np.zeros(3)]).tip
    assert away.max() < 1.1 * np.linalg.norm(bent - statics.solve(start.joints, np.zeros(6)).tip)
    assert moved[:2].max() < 2.0 * math.pi  # each rotation moves by less than a turn in all


def test_reference_inverse_determines_which_tips_can_be_held(case):
    holdable, not_holdable = draw(0, case, PEAK), draw(7, case, PEAK)

    assert reference_error(prepare_case(case, holdable), 0, holdable) < 1e-6
    assert reference_error(prepare_case(case, not_holdable), 7, not_holdable) > 5e-3


def test_summary_counts_a_hold_as_a_failure_if_the_tip_was_holdable():
    def outcome(seed: int, holdable: bool, completed: bool, error: float) -> StartOutcome:
        return StartOutcome(seed, (0.0, 0.0, -0.1), (1.0, 0.0, 0.0), holdable, 0.0, completed, "", error)

    made = [outcome(seed, True, True, 0.1 * seed) for seed in range(9)]
    result = summary(
        [*made, outcome(9, True, False, 0.1), outcome(10, False, False, 9.0), outcome(11, False, True, 0.5)]
    )

    assert result["holdable"] == 10
    assert result["error_mm"]["p50"] == pytest.approx(0.4)
    assert result["error_mm"]["p90"] == pytest.approx(0.8)
    assert math.isinf(result["error_mm"]["p95"])
    assert result["holdable_but_hold"] == [9]
    assert result["not_holdable_and_hold"] == 1
    assert [each["seed"] for each in result["not_holdable_but_completed"]] == [11]
    json.dumps(result["not_holdable_but_completed"])
