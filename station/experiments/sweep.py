"""Many seeds of one experiment, as it is or with keys of its file set to each of several values.

Every run is a case in virtual time in a process of its own, bit for bit what `run` does with that seed.
"""

import itertools
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from station.clock import VirtualClock
from station.config import ConfigError
from station.experiments.experiment import Case, Experiment, load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.experiments.sweep_settings import Setting, nested
from station.interrupt import interrupts

#: Threads that libraries start by themselves would only fight over the processors.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class SweepFailed(CtrError):
    """A sweep that lost one of its processes."""


class Job(NamedTuple):
    """One run of a sweep."""

    setting: Setting
    case: Case
    seed: int


class Outcome(NamedTuple):
    """A run and its numbers."""

    job: Job
    numbers: Mapping[str, Any]  #: those of `summarise`


class Spread(NamedTuple):
    """One number over all seeds."""

    median: float
    worst: float
    p5: float
    p95: float


def jobs(experiment: str, chosen: Sequence[Setting], seeds: Sequence[int], only: str | None = None) -> list[Job]:
    """All runs, after the experiment has been checked whole with every setting.

    Args:
        experiment: preset or file.
        chosen: what is set on top of every case.
        seeds: of everything random in the virtual lab.
        only: the one case to run; None: all.

    Raises:
        ConfigError: with file, case, key, value and what was expected.
    """
    listed: list[Job] = []
    for setting in chosen:
        cases = load_experiment(experiment, nested(setting)).cases
        if only is not None and only not in [case.name for case in cases]:
            raise ConfigError(f"--case {only}: the cases are {', '.join(case.name for case in cases)}")
        listed += [Job(setting, case, seed) for case in cases if only in (None, case.name) for seed in seeds]
    return listed


def run_job(job: Job) -> Outcome:
    """One run."""
    return Outcome(job, summarise(run_case(job.case, job.seed, VirtualClock(), lambda _: None)))


def sweep(listed: Sequence[Job], processes: int, told: Callable[[int], None]) -> list[Outcome]:
    """Carry out all of `listed`, `processes` at a time; `told` how many are done.

    Ctrl-C ends the runs that are on, leaves out the others, and what is done comes back.

    Raises:
        SweepFailed: a process was killed.
    """
    before = set(active_children())
    context = get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent) as pool:
        with _one_thread_each(), _deaf_to_interrupts():
            futures = [pool.submit(run_job, job) for job in listed]
        _wait(futures, before, told)
    try:
        return [future.result() for future in futures if not future.cancelled()]
    except BrokenProcessPool:
        raise SweepFailed(
            "a process of the sweep ended by itself; was it killed, or is there too little memory?"
        ) from None


def _wait(futures: Sequence[Future[Outcome]], others: set[BaseProcess], told: Callable[[int], None]) -> None:
    """Until all are done or Ctrl-C was pressed; `others` are processes that are not the pool's."""
    with interrupts() as interrupted:
        waiting = set(futures)
        while waiting:
            done, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            if done:
                told(len(futures) - len(waiting))
            if interrupted():
                waiting = {future for future in waiting if not future.cancel()}
                for child in set(active_children()) - others:
                    # A run takes it as a question and ends; between runs it is ignored, and a run that was
                    # next in the line may begin yet: asked again until none is left.
                    if child.pid is not None:
                        os.kill(child.pid, signal.SIGINT)


def spreads(outcomes: Sequence[Outcome]) -> dict[str, Spread]:
    """Every number that all completed runs have, by its dotted name; axes are x, y and z."""
    tables = [dict(_numbers("", outcome.numbers)) for outcome in outcomes if outcome.numbers["completed"]]
    found: dict[str, Spread] = {}
    for name in tables[0] if tables else ():
        values = [table[name] for table in tables if name in table]
        if len(values) == len(tables):
            p5, median, p95 = np.round(np.percentile(values, (5.0, 50.0, 95.0)), 5).tolist()
            found[name] = Spread(median, max(values), p5, p95)
    return found


def grouped(outcomes: Sequence[Outcome]) -> Iterator[tuple[Setting, str, list[Outcome]]]:
    """Outcomes of each setting and case, in the order of the jobs."""
    for (setting, case), group in itertools.groupby(outcomes, lambda one: (one.job.setting, one.job.case.name)):
        yield setting, case, list(group)


def sweep_summary(
    experiment: Experiment, listed: Sequence[Job], outcomes: Sequence[Outcome], wall_s: float
) -> dict[str, Any]:
    """All of it as one JSON object; the numbers of each single run are in it too."""
    completed = len(outcomes) == len(listed) and all(outcome.numbers["completed"] for outcome in outcomes)
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "labs": sorted({job.case.lab.title for job in listed}),
        "completed": completed,
        "wall_s": round(wall_s, 3),
        "seeds": sorted({job.seed for job in listed}),
        "planned": len(listed),
        "settings": [
            {
                "setting": dict(setting),
                "case": case,
                "runs": len(group),
                "completed": sum(bool(outcome.numbers["completed"]) for outcome in group),
                "spreads": {name: spread._asdict() for name, spread in spreads(group).items()},
            }
            for setting, case, group in grouped(outcomes)
        ],
        "runs": [
            {
                "setting": dict(outcome.job.setting),
                "case": outcome.job.case.name,
                "seed": outcome.job.seed,
                **outcome.numbers,
            }
            for outcome in outcomes
        ],
    }


def _end_with_parent() -> None:
    """In each new process: watch whether the one that started it is still there."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """New processes ignore Ctrl-C from their first moment on; only a run listens to it."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals go to the main thread
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """New processes start with this environment."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) == 3:
        for axis, inner in zip("xyz", value, strict=True):
            yield from _numbers(f"{name}.{axis}", inner)
    elif isinstance(value, float | int) and not isinstance(value, bool) and name not in ("wall_s", "simulated_s"):
        yield name, float(value)
