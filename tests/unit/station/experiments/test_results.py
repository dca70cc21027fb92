"""The numbers of a run, from a made-up recording whose errors are known."""

import math

import numpy as np
import pytest

from station.control.telemetry import Channels
from station.experiments.results import summarise
from station.experiments.runner import Recording
from station.lab.loads import Load, NoLoad, TrapezoidLoad
from tests.harness.cases import a_case

#: 4 s at 10 Hz, a frame at every other row, 50 ms old.
TIMES = np.arange(40) * 0.1
FRAMES = np.arange(40) % 2 == 0
AGE = 0.05
NO_LOAD = NoLoad()


@pytest.fixture
def recording(paper_robot):
    """A recording in which everything is zero but for the groups given, (40,) or (40, n) each."""

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


def test_true_errors_are_desired_minus_true_after_the_settling_time(recording):
    # 1 mm and -3 mm by turns in x after 2 s, 100 mm before; 4 mm in z all the time
    x = np.where(TIMES < 2.0 - 1e-9, 0.1, np.where(np.arange(40) % 2 == 0, 0.001, -0.003))
    summary = summarise(recording(tip_desired=vectors(x), tip_true=vectors(z=-0.004), **KNOWN))

    assert summary["true_max_abs_error_mm"] == pytest.approx([3.0, 0.0, 4.0])
    # sqrt((1 + 9) / 2), and the mean of sqrt(1 + 16) and sqrt(9 + 16); rounded to 0.1 um
    assert summary["true_rms_error_mm"] == pytest.approx([math.sqrt(5.0), 0.0, 4.0], abs=1e-4)
    assert summary["true_mean_error_mm"] == pytest.approx((math.sqrt(17.0) + 5.0) / 2.0, abs=1e-4)


def test_measured_errors_compare_each_frame_with_the_setpoint_of_its_own_moment(recording):
    # The setpoint goes up 10 mm/s; each frame shows it exactly as it was 50 ms before the row.
    desired = vectors(z=0.010 * TIMES)
    measured = vectors(z=0.010 * (TIMES - AGE))
    summary = summarise(recording(tip_desired=desired, tip_measured=measured, tip_true=measured, **KNOWN))

    assert summary["max_abs_error_mm"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert summary["true_max_abs_error_mm"] == pytest.approx([0.0, 0.0, 0.5])


def test_only_new_frames_count(recording):
    # Between frames the old value stands; here it is nonsense.
    measured = vectors(y=np.where(FRAMES, 0.002, 55.0))
    summary = summarise(recording(tip_measured=measured))

    assert summary["max_abs_error_mm"] == pytest.approx([0.0, 2.0, 0.0])
    assert summary["rms_error_mm"] == pytest.approx([0.0, 2.0, 0.0])
    assert summary["mean_error_mm"] == pytest.approx(2.0)


def test_without_a_known_truth_there_are_no_true_errors(recording):
    summary = summarise(recording())

    assert "max_abs_error_mm" in summary
    assert not [key for key in summary if key.startswith("true_")]
    assert "force_rms_error_N" not in summary


def test_the_force_estimate_is_compared_with_the_true_force(recording):
    summary = summarise(recording(force=vectors(0.3, 0.02), force_true=vectors(0.2, 0.02), **KNOWN))

    assert summary["force_rms_error_N"] == pytest.approx([0.1, 0.0, 0.0])


def test_the_models_are_compared_with_the_measured_tip_as_mean_distance(recording):
    # 3-4-5 in millimetres for one, 12 mm for the other
    summary = summarise(recording(tip_estimated=vectors(0.003, 0.004), tip_unloaded=vectors(z=0.012)))

    assert summary["model_error_mm"] == {"loaded": pytest.approx(5.0), "unloaded": pytest.approx(12.0)}


def test_the_parts_of_the_deflection_are_reported_by_their_largest_value(recording):
    swing = np.sin(np.arange(40))
    summary = summarise(recording(settling=0.0, delta_1=vectors(-0.010 * np.abs(swing)), delta_2=vectors(y=0.001)))

    assert summary["deflection_max_mm"]["delta_1"] == pytest.approx([10.0 * np.abs(swing).max(), 0.0, 0.0], abs=1e-4)
    assert summary["deflection_max_mm"]["delta_2"] == pytest.approx([0.0, 1.0, 0.0])
    assert summary["deflection_max_mm"]["deflection"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("start", "largest"), [(0.9, 7.0), (0.3, 9.0), (3.0, 1.0)])
def test_a_load_is_no_part_of_the_settling(recording, start, largest):
    # 9 mm until 0.5 s, 7 mm until 1.5 s, 1 mm after that; the settling time is 2 s
    x = np.where(TIMES < 0.5, 0.009, np.where(TIMES < 1.5, 0.007, 0.001))
    load = TrapezoidLoad(magnitude=0.5, rise=0.1, start=start)
    summary = summarise(recording(tip_desired=vectors(x), load=load, **KNOWN))

    assert summary["counted_from_s"] == min(start, 2.0)
    assert summary["true_max_abs_error_mm"] == pytest.approx([largest, 0.0, 0.0])
    assert summary["true_max_distance_mm"] == pytest.approx(largest)


def test_true_errors_are_told_from_each_change_of_the_load_to_the_next(recording):
    # 1 mm at first, 3 mm from 1 s on, 2 mm from 2.6 s on; the load is put on at 1 s and taken off from 2.6 s on
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


def test_what_did_not_get_past_the_settling_time_has_no_numbers_but_says_how_it_ended(recording):
    cut = recording(settling=20.0)._replace(completed=False, cause="interrupted")

    assert summarise(cut) == {"completed": False, "cause": "interrupted", "simulated_s": 6.0, "wall_s": 0.5}


def test_a_recording_without_rows_has_no_numbers_either(recording):
    whole = recording()
    empty = whole._replace(rows=np.empty((0, len(whole.channels))), completed=False, cause="interrupted")

    assert summarise(empty)["cause"] == "interrupted"
    assert "max_abs_error_mm" not in summarise(empty)
