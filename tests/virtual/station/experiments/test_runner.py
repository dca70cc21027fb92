"""One case in the virtual lab, from connecting the devices to the end or an early stop."""

import math
import os
import signal
from typing import NamedTuple

import numpy as np
import pytest

from station.config.loads import ConstantLoad, RaisedCosineLoad
from station.control.clock import VirtualClock
from station.control.states import State
from station.experiments import runner
from station.experiments.runner import Recording, run_case
from station.lab.config import LabConfig, PlantConfig, TrackerConfig
from tests.harness.cases import a_case, a_run

SEED = 3


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Return one second of a motion, kept in memory."""
    return a_run(a_case("fig10", "feedforward", duration=1.0), SEED)


class Streamed(NamedTuple):
    """The run of `recording` again, with rows and progress received by callbacks."""

    recording: Recording
    rows: list[np.ndarray]
    progress: list[float]


@pytest.fixture(scope="module")
def streamed() -> Streamed:
    rows: list[np.ndarray] = []
    progress: list[float] = []
    case = a_case("fig10", "feedforward", duration=1.0)
    run = run_case(case, SEED, VirtualClock(), progress.append, lambda row: rows.append(row.copy()))
    return Streamed(run, rows, progress)


def test_runs_with_the_same_seed_give_the_same_rows_bit_for_bit_in_memory_and_recorded(recording, streamed):
    assert recording.completed
    assert recording.rows.tobytes() == np.array(streamed.rows).tobytes()
    assert streamed.recording.rows.shape == (0, len(streamed.recording.channels))
    assert streamed.recording.completed
    assert streamed.recording.rates == recording.rates


def test_runs_with_different_seeds_give_different_rows(recording):
    other = a_run(a_case("fig10", "feedforward", duration=0.2), SEED + 1)

    assert len(other.rows) == 100
    assert not np.array_equal(recording.rows[:100], other.rows)


def test_every_tick_of_the_motion_has_a_row_with_time_from_its_start(recording):
    time = recording.channels.of(recording.rows, "time")[:, 0]

    assert recording.cause == ""
    assert time == pytest.approx(np.arange(500) * 0.002, abs=1e-9)
    assert (recording.channels.of(recording.rows, "state") == State.RUNNING).all()
    assert np.isfinite(recording.rows).all()
    # The simulated time also covers connecting and 2 s at rest before the motion.
    assert 3.2 < recording.simulated_s < 8.0
    assert recording.wall_s > 0.0


def test_tracker_frames_in_a_recording_keep_their_measurement_time(recording):
    new = recording.channels.of(recording.rows, "tip_new")[:, 0] > 0.0
    late = (recording.channels.of(recording.rows, "time") - recording.channels.of(recording.rows, "tip_time"))[new, 0]

    assert new.sum() == 40
    assert (late >= 0.024 - 1e-9).all()
    # A frame is polled up to 5 ms after it is ready; then its reply must arrive and be read.
    assert (late < 0.034).all()


def test_the_progress_of_a_run_rises_until_its_end(streamed):
    assert streamed.progress == sorted(streamed.progress)
    assert streamed.progress[0] == 0.0
    assert 0.4 < streamed.progress[-1] <= 1.0


def test_the_time_of_the_load_counts_from_the_start_of_the_motion():
    load = RaisedCosineLoad(peak=0.5, period=2.0)
    recording = a_run(a_case("fig8", "regulation", duration=1.5, load=load))
    time, force = (recording.channels.of(recording.rows, group) for group in ("time", "force_true"))

    expected = 0.25 * (1.0 - np.cos(math.pi * time[:, 0]))
    assert force[:, 0] == pytest.approx(expected, abs=1e-9)
    assert not force[:, 1:].any()


def test_ctrl_c_ends_a_run_and_keeps_its_rows():
    def interrupt(done: float) -> None:
        if 0.4 < done < 0.6:
            os.kill(os.getpid(), signal.SIGINT)

    recording = run_case(a_case("fig10", "paper", duration=3.0), 0, VirtualClock(), interrupt)

    assert (recording.completed, recording.cause) == (False, "interrupted")
    assert 0.4 * 1500 < len(recording.rows) < 1500
    assert np.isfinite(recording.rows).all()


def test_ctrl_c_before_the_motion_leaves_a_recording_with_all_channels_and_no_rows():
    def interrupt(_: float) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    recording = run_case(a_case("fig10", "paper"), 0, VirtualClock(), interrupt)

    assert not recording.completed
    assert recording.rows.shape == (0, len(recording.channels))


def test_a_load_beyond_the_robots_reach_ends_the_run_with_a_cause():
    recording = a_run(a_case("fig8", "regulation", duration=2.0, load=ConstantLoad.model_construct(magnitude=1e6)))

    assert not recording.completed
    assert "1000000" in recording.cause
    assert "\n" not in recording.cause


def test_a_lab_whose_tracker_never_answers_ends_the_run_with_a_cause(monkeypatch):
    monkeypatch.setattr(runner, "CONNECT_TIMEOUT_S", 8.0)
    case = a_case("fig10", "paper")._replace(lab=LabConfig(tracker=TrackerConfig(latency=1e6)))
    recording = a_run(case)

    assert not recording.completed
    assert recording.cause
    assert "tracker" in recording.cause


def test_tubes_drawn_from_the_seed_differ_from_the_description():
    case = a_case("fig8", "regulation", duration=0.1)._replace(lab=LabConfig(plant=PlantConfig(vary=0.08)))
    tips = [a_run(case, seed) for seed in (1, 2)]

    assert np.linalg.norm(np.subtract(*(run.channels.of(run.rows, "tip_true")[0] for run in tips))) > 1e-4
