"""One case in the virtual lab, from bring-up to the end, or to whatever ends it before."""

import math
import os
import signal

import numpy as np
import pytest

from station.clock import VirtualClock
from station.experiments.runner import run_case
from station.lab.config import LabConfig, PlantConfig, TrackerConfig
from station.lab.loads import ConstantLoad, RaisedCosineLoad
from station.states import State


def test_the_same_seed_twice_gives_the_same_rows_bit_for_bit(a_case, a_run):
    case = a_case("fig10", "feedforward", duration=1.0)
    first, again = a_run(case, 3), a_run(case, 3)

    assert first.completed
    assert first.rows.tobytes() == again.rows.tobytes()


def test_another_seed_gives_other_rows(a_case, a_run):
    case = a_case("fig10", "feedforward", duration=0.2)
    rows = [a_run(case, seed).rows for seed in (3, 4)]

    assert rows[0].shape == rows[1].shape
    assert not np.array_equal(rows[0], rows[1])


def test_there_is_a_row_for_every_tick_of_the_motion_with_time_from_its_start(a_case, a_run):
    recording = a_run(a_case("fig10", "paper", duration=0.7))
    time = recording.channels.of(recording.rows, "time")[:, 0]

    assert recording.completed
    assert recording.cause == ""
    assert time == pytest.approx(np.arange(350) * 0.002, abs=1e-9)
    assert (recording.channels.of(recording.rows, "state") == State.RUNNING).all()
    assert np.isfinite(recording.rows).all()
    # connecting and 2 s at rest before
    assert 3.2 < recording.simulated_s < 8.0
    assert recording.wall_s > 0.0


def test_frames_keep_their_own_time(a_case, a_run):
    recording = a_run(a_case("fig10", "paper", duration=0.5))
    new = recording.channels.of(recording.rows, "tip_new")[:, 0] > 0.0
    late = (recording.channels.of(recording.rows, "time") - recording.channels.of(recording.rows, "tip_time"))[new, 0]

    assert new.sum() == 20
    assert (late >= 0.024 - 1e-9).all()
    # asked for up to 5 ms after it was there, and the reply has to come in and be looked at
    assert (late < 0.034).all()


def test_the_loads_time_counts_from_the_start_of_the_motion(a_case, a_run):
    load = RaisedCosineLoad(peak=0.5, period=2.0)
    recording = a_run(a_case("fig8", "regulation", duration=1.5, load=load))
    time, force = (recording.channels.of(recording.rows, group) for group in ("time", "force_true"))

    expected = 0.25 * (1.0 - np.cos(math.pi * time[:, 0]))
    assert force[:, 0] == pytest.approx(expected, abs=1e-9)
    assert not force[:, 1:].any()


def test_progress_rises_to_the_end(a_case):
    told: list[float] = []
    run_case(a_case("fig10", "paper", duration=3.0), 0, VirtualClock(), told.append)

    assert told == sorted(told)
    assert told[0] == 0.0
    assert 0.8 < told[-1] <= 1.0


def test_rows_that_are_recorded_as_they_come_are_those_that_are_kept_otherwise(a_case, a_run):
    case = a_case("fig10", "paper", duration=0.5)
    recorded: list[np.ndarray] = []
    run = run_case(case, 3, VirtualClock(), lambda _: None, lambda row: recorded.append(row.copy()))

    assert (np.array(recorded) == a_run(case, 3).rows).all()
    assert run.rows.shape == (0, len(run.channels))
    assert run.completed
    assert run.rates == a_run(case, 3).rates


def test_an_interrupt_ends_the_run_and_keeps_what_was_recorded(a_case):
    def interrupt(done: float) -> None:
        if 0.4 < done < 0.6:
            os.kill(os.getpid(), signal.SIGINT)

    recording = run_case(a_case("fig10", "paper", duration=3.0), 0, VirtualClock(), interrupt)

    assert (recording.completed, recording.cause) == (False, "interrupted")
    assert 0.4 * 1500 < len(recording.rows) < 1500
    assert np.isfinite(recording.rows).all()


def test_an_interrupt_before_the_motion_leaves_no_rows_but_all_channels(a_case):
    def interrupt(_: float) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    recording = run_case(a_case("fig10", "paper"), 0, VirtualClock(), interrupt)

    assert not recording.completed
    assert recording.rows.shape == (0, len(recording.channels))


def test_a_load_beyond_the_robots_reach_ends_the_run_with_a_cause(a_case, a_run):
    recording = a_run(a_case("fig8", "regulation", duration=2.0, load=ConstantLoad.model_construct(magnitude=1e6)))

    assert not recording.completed
    assert "1000000" in recording.cause
    assert "\n" not in recording.cause


def test_a_lab_whose_tracker_never_answers_ends_the_run_with_a_cause(a_case, a_run):
    case = a_case("fig10", "paper")._replace(lab=LabConfig(tracker=TrackerConfig(latency=1e6)))
    recording = a_run(case)

    assert not recording.completed
    assert recording.cause
    assert "tracker" in recording.cause


def test_tubes_drawn_from_the_seed_are_another_robot(a_case, a_run):
    case = a_case("fig8", "regulation", duration=0.1)._replace(lab=LabConfig(plant=PlantConfig(vary=0.08)))
    tips = [a_run(case, seed) for seed in (1, 2)]

    assert np.linalg.norm(np.subtract(*(run.channels.of(run.rows, "tip_true")[0] for run in tips))) > 1e-4
