"""Summary numbers of synthetic recordings with known errors."""

import numpy as np
import pytest

from station.config.loads import Load, NoLoad, TrapezoidLoad
from station.control.telemetry import Channels
from station.experiments.results import fit_step, fold, summarise
from station.experiments.runner import Recording
from tests.harness.cases import a_case

#: Rows of 4 s at 10 Hz. Every other row has a new tracker frame, which is 50 ms old.
TIMES = np.arange(40) * 0.1
FRAMES = np.arange(40) % 2 == 0
AGE = 0.05
NO_LOAD = NoLoad()


@pytest.fixture
def recording(paper_robot):
    """Return a function that makes a recording with the given groups, (40,) or (40, n), and zeros elsewhere."""

    def make(
        settling: float = 2.0, experiment: str = "fig10", name: str = "paper", load: Load = NO_LOAD,
        **groups: np.ndarray,
    ) -> Recording:  # fmt: skip
        channels = Channels(paper_robot)
        rows = np.zeros((40, len(channels)))
        channels.of(rows, "time")[:, 0] = TIMES
        channels.of(rows, "tip_new")[:, 0] = FRAMES
        channels.of(rows, "tip_time")[:, 0] = np.where(FRAMES, TIMES - AGE, 0.0)
        for group, values in groups.items():
            columns = channels.of(rows, group)
            columns[:] = values.reshape(len(rows), -1)
        case = a_case(experiment, name, settling=settling, load=load)
        return Recording(case, channels, rows, True, "", 6.0, 0.5)

    return make


def vectors(x: object = 0.0, y: object = 0.0, z: object = 0.0) -> np.ndarray:
    return np.stack([np.broadcast_to(np.asarray(part, dtype=float), 40) for part in (x, y, z)], axis=1)


KNOWN = {"truth_known": np.ones(40)}


def test_a_recording_without_ground_truth_has_no_true_errors(recording):
    summary = summarise(recording())

    assert "max_abs_error_mm" in summary
    assert not [key for key in summary if key.startswith("true_")]
    assert "force_rms_error_N" not in summary


def test_the_force_estimate_is_compared_with_the_true_force(recording):
    summary = summarise(recording(force=vectors(0.3, 0.02), force_true=vectors(0.2, 0.02), **KNOWN))

    assert summary["force_rms_error_N"] == pytest.approx([0.1, 0.0, 0.0])


def test_the_summary_has_the_mean_distance_of_each_model_from_the_measured_tip(recording):
    # The loaded model is off by sqrt(3^2 + 4^2) = 5 mm, the unloaded model by 12 mm.
    summary = summarise(recording(tip_estimated=vectors(0.003, 0.004), tip_unloaded=vectors(z=0.012)))

    assert summary["model_error_mm"] == {"loaded": pytest.approx(5.0), "unloaded": pytest.approx(12.0)}


def test_the_summary_has_the_largest_value_of_each_part_of_the_deflection(recording):
    swing = np.sin(np.arange(40))
    summary = summarise(recording(settling=0.0, delta_1=vectors(-0.010 * np.abs(swing)), delta_2=vectors(y=0.001)))

    assert summary["deflection_max_mm"]["delta_1"] == pytest.approx([10.0 * np.abs(swing).max(), 0.0, 0.0], abs=1e-4)
    assert summary["deflection_max_mm"]["delta_2"] == pytest.approx([0.0, 1.0, 0.0])
    assert summary["deflection_max_mm"]["deflection"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("start", "largest"), [(0.9, 7.0), (0.3, 9.0), (3.0, 1.0)])
def test_errors_count_from_a_load_onset_within_the_settling_time(recording, start, largest):
    # The error is 9 mm until 0.5 s, 7 mm until 1.5 s, then 1 mm. The settling time is 2 s.
    x = np.where(TIMES < 0.5, 0.009, np.where(TIMES < 1.5, 0.007, 0.001))
    load = TrapezoidLoad(magnitude=0.5, rise=0.1, start=start)
    summary = summarise(recording(tip_desired=vectors(x), load=load, **KNOWN))

    assert summary["counted_from_s"] == min(start, 2.0)
    assert summary["true_max_abs_error_mm"] == pytest.approx([largest, 0.0, 0.0])
    assert summary["true_max_distance_mm"] == pytest.approx(largest)


def test_true_errors_are_summarised_between_changes_of_the_load(recording):
    # The error is 1 mm at first, 3 mm from 1 s on (load applied), and 2 mm from 2.6 s on (load removed).
    x = np.where(TIMES < 1.0 - 1e-9, 0.001, np.where(TIMES < 2.6 - 1e-9, 0.003, 0.002))
    load = TrapezoidLoad(magnitude=0.5, rise=0.6, stay=1.0, start=1.0)
    short = {"load": load, "tip_desired": vectors(x), **KNOWN}
    summary = summarise(recording(**short))

    assert list(summary["by_change"]) == ["1 s", "2.6 s"]
    assert summary["by_change"]["1 s"]["true_max_distance_mm"] == pytest.approx(3.0)
    assert summary["by_change"]["2.6 s"]["true_max_abs_error_mm"] == pytest.approx([2.0, 0.0, 0.0])
    assert "by_change" not in summarise(recording(**(short | {"load": NO_LOAD})))


def test_a_sweep_of_a_joint_has_no_tracking_error(recording):
    summary = summarise(recording(experiment="fig6", name="turn", tip_true=vectors(0.1), **KNOWN))

    assert not [key for key in summary if key.endswith("max_abs_error_mm")]
    assert "model_error_mm" in summary


def test_a_run_shorter_than_the_settling_time_has_an_outcome_and_no_errors(recording):
    cut = recording(settling=20.0)._replace(completed=False, cause="interrupted")

    summary = summarise(cut)
    assert summary.pop("model") == "the paper's integrator, sub-links of 10 mm"
    assert summary == {"completed": False, "cause": "interrupted", "simulated_s": 6.0, "wall_s": 0.5}


def test_a_recording_without_rows_has_no_errors(recording):
    whole = recording()
    empty = whole._replace(rows=np.empty((0, len(whole.channels))), completed=False, cause="interrupted")

    assert summarise(empty)["cause"] == "interrupted"
    assert "max_abs_error_mm" not in summarise(empty)


STEP_TIMES = np.arange(0.0, 6.0, 0.002)


@pytest.mark.parametrize(("rate", "dead_time"), [(1.0, 0.0), (2.5, 0.03), (5.0, 0.2)])
def test_the_step_fit_recovers_rate_and_dead_time_of_a_noisy_response(rate, dead_time):
    noise = np.random.default_rng(1).normal(scale=0.05, size=STEP_TIMES.size)
    response = np.where(dead_time < STEP_TIMES, 1.0 - np.exp(-rate * (STEP_TIMES - dead_time)), 0.0)

    exact, noisy = fit_step(STEP_TIMES, response), fit_step(STEP_TIMES, response + noise)

    assert exact == pytest.approx((rate, dead_time), abs=1e-3)
    assert noisy.rate == pytest.approx(rate, rel=0.03)
    assert noisy.dead_time == pytest.approx(dead_time, abs=0.02)


def test_fold_averages_a_square_wave_into_one_step():
    there = 1.0 - np.exp(-2.0 * STEP_TIMES)
    times = np.arange(0.0, 4 * 6.0 + 1.0, 0.002)
    response = np.r_[there, 1.0 - there, there, 1.0 - there, np.zeros(500)]  # one incomplete stay at the end

    folded_times, folded = fold(times, response, 6.0)

    np.testing.assert_allclose(folded_times, STEP_TIMES, atol=1e-9)
    np.testing.assert_allclose(folded, there, atol=1e-12)
