"""Jobs in this process and in others: the same results, the progress, Ctrl-C, and killed processes."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import psutil
import pytest

from station.jobs.interrupts import JobInterrupted, interrupts
from station.jobs.processes import Processes
from station.jobs.run_jobs import ProcessLost, run_jobs
from tests.harness.children import children
from tests.harness.waiting import NET

Progress = Callable[[float], None]


def square(number: int, progress: Progress) -> int:
    progress(0.5)
    return number * number


def die(number: int, progress: Progress) -> int:
    if number < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number, progress)


def die_once(mark: Path, progress: Progress) -> int:
    """Kill the process of the job, except in the second attempt."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(7, progress)


def wait_for_ctrl_c(_: int, progress: Progress) -> int:
    with interrupts() as interrupted:
        progress(0.5)
        while not interrupted():
            time.sleep(0.01)
    raise JobInterrupted


def test_run_jobs_stores_the_results_of_the_jobs_that_the_manifest_does_not_have_with_progress():
    jobs = {"a": 3, "b": 4, "c": 5}
    reported: list[Mapping[str, float]] = []
    here, there = {"b": 0}, {"b": 0}
    run_jobs(square, jobs, None, here, reported.append)
    assert reported == [{"a": 0.5}, {}, {"c": 0.5}, {}]
    with Processes(2) as workers:
        run_jobs(square, jobs, workers, there, reported.append)
        assert here == there == {"a": 9, "b": 0, "c": 25}
        assert all(0.0 <= part <= 1.0 for parts in reported for part in parts.values())

        some = dict[int, int]()
        run_jobs(square, dict(enumerate(range(2000))), workers, some, proceed=lambda result: result != 0)
        assert some[0] == 0
        assert len(some) < 2000
    few = dict[str, int]()
    run_jobs(square, {"a": 1, "b": 0, "c": 2}, None, few, proceed=lambda result: result != 0)
    assert few == {"a": 1, "b": 0}


def test_a_job_that_kills_its_process_loses_no_other_job_and_leaves_the_environment():
    before = {name: value for name, value in os.environ.items() if "THREADS" in name}
    found = dict[int, int | str]()
    with Processes(2) as workers:
        run_jobs(die, {number: number for number in (1, -2, 3, 4, -5)}, workers, found, lost=lambda job: f"lost {job}")
        assert found == {1: 1, -2: "lost -2", 3: 9, 4: 16, -5: "lost -5"}
        with pytest.raises(ProcessLost, match="was it killed"):
            run_jobs(die, {-1: -1}, workers, found)
    assert {name: value for name, value in os.environ.items() if "THREADS" in name} == before


def test_a_job_whose_process_is_killed_once_is_repeated(tmp_path):
    found = dict[int, int]()
    (tmp_path / "two").touch()
    with Processes(2) as workers:
        run_jobs(die_once, {1: tmp_path / "one", 2: tmp_path / "two"}, workers, found, lost=lambda _: -1)
    assert found == {1: 49, 2: 49}


def test_ctrl_c_ends_the_running_jobs_starts_no_other_and_leaves_no_process():
    others, started, found = children(word="spawn_main"), list[psutil.Process](), dict[int, int]()

    def press(running: Mapping[int, float]) -> None:
        if 0.5 in running.values() and not started:
            started.extend(child for child in children(word="spawn_main") if child not in others)
            os.kill(os.getpid(), signal.SIGINT)

    with Processes(1) as workers:
        run_jobs(wait_for_ctrl_c, dict.fromkeys(range(4)), workers, found, press)
    assert (found, len(started)) == ({}, 1)
    assert psutil.wait_procs(started, timeout=NET)[1] == []
