"""Jobs in processes: the same results as one after the other, how far they are, and what a lost process leaves."""

import os
import signal
from collections.abc import Callable

import pytest

from station.experiments.experiment import load_experiment
from station.experiments.output import ResultFolder, run_recorded
from station.experiments.side_by_side import Processes, ProcessLost, one_after_the_other
from station.recording.read import read_case
from tests.harness.cases import a_run


def square(number: int, progress: Callable[[float], None]) -> int:
    progress(0.5)
    return number * number


def die(number: int, progress: Callable[[float], None]) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def everything(_: object) -> bool:
    return True


def test_results_come_in_the_order_of_the_jobs_and_every_part_is_told_at_the_end():
    told: list[list[float]] = []
    with Processes(2) as started:
        assert started.carry_out(square, [3, 4, 5], lambda parts: told.append(list(parts))) == [9, 16, 25]

    assert told[-1] == [1.0, 1.0, 1.0]
    assert all(0.0 <= part <= 1.0 for parts in told for part in parts)


def test_after_a_result_that_is_refused_no_other_job_is_begun():
    with Processes(1) as started:
        results = started.carry_out(square, list(range(2000)), lambda _: None, lambda result: result != 0)

    assert results[0] == 0
    assert len(results) < 2000
    assert one_after_the_other(square, [3, 0, 5], lambda _: None, lambda result: result != 0) == [9, 0]


def test_here_the_same_is_told_and_done():
    told: list[list[float]] = []

    assert one_after_the_other(square, [1, 2], lambda parts: told.append(list(parts)), everything) == [1, 4]
    assert told == [[0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]


def test_a_process_that_is_killed_is_told_in_words():
    with pytest.raises(ProcessLost, match="was it killed"), Processes(1) as started:
        started.carry_out(die, [1], lambda _: None)


def test_cases_side_by_side_have_the_rows_of_one_after_the_other_bit_for_bit(write, short, tmp_path):
    experiment = load_experiment(str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n")))
    for case in experiment.cases:
        a_run(case)  # what a process has just compiled itself may round otherwise than what all others load
    rows = []
    for jobs in (1, 2):
        folder = ResultFolder(tmp_path / str(jobs), experiment, 0)
        with Processes(jobs) as started:
            started.carry_out(run_recorded, [folder.assignment(case) for case in experiment.cases], lambda _: None)
        folder.finish({})
        rows.append([read_case(folder.path / f"{case.name}.mcap").rows for case in experiment.cases])

    for alone, beside in zip(*rows, strict=True):
        assert len(alone) == 500
        assert alone.tobytes() == beside.tobytes()
