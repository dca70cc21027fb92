"""Jobs in processes: the results of a serial run, the progress, and the error of a lost process."""

import os
import signal
from collections.abc import Callable

import pytest

from station.experiments.experiment import load_experiment
from station.experiments.job_pool import JobPool, ProcessLost, run_serially
from station.experiments.output import ResultFolder, run_recorded
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


def test_the_job_pool_returns_results_in_job_order_and_its_progress_ends_at_one():
    reported: list[list[float]] = []
    with JobPool(2) as pool:
        assert pool.carry_out(square, [3, 4, 5], lambda parts: reported.append(list(parts))) == [9, 16, 25]

    assert reported[-1] == [1.0, 1.0, 1.0]
    assert all(0.0 <= part <= 1.0 for parts in reported for part in parts)


def test_the_job_pool_starts_no_further_job_after_a_refused_result():
    with JobPool(1) as pool:
        results = pool.carry_out(square, list(range(2000)), lambda _: None, lambda result: result != 0)

    assert results[0] == 0
    assert len(results) < 2000
    assert run_serially(square, [3, 0, 5], lambda _: None, lambda result: result != 0) == [9, 0]


def test_run_serially_reports_progress_and_returns_all_results():
    reported: list[list[float]] = []

    assert run_serially(square, [1, 2], lambda parts: reported.append(list(parts)), everything) == [1, 4]
    assert reported == [[0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]


def test_a_killed_worker_process_of_the_job_pool_raises_process_lost():
    with pytest.raises(ProcessLost, match="was it killed"), JobPool(1) as pool:
        pool.carry_out(die, [1], lambda _: None)


def test_cases_run_in_parallel_have_the_same_rows_as_serial_ones_bit_for_bit(write, short, tmp_path):
    experiment = load_experiment(str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n")))
    for case in experiment.cases:
        a_run(case)  # compiles first: code just compiled may round differently from loaded code
    rows = []
    for jobs in (1, 2):
        folder = ResultFolder(tmp_path / str(jobs), experiment, 0)
        with JobPool(jobs) as pool:
            pool.carry_out(run_recorded, [folder.assignment(case) for case in experiment.cases], lambda _: None)
        folder.finish({})
        rows.append([read_case(folder.path / f"{case.name}.mcap").rows for case in experiment.cases])

    for serial, parallel in zip(*rows, strict=True):
        assert len(serial) == 500
        assert serial.tobytes() == parallel.tobytes()
