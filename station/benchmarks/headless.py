"""`ctr-station bench headless` and `bench tick`: speed of a simulated run, and time of a tick of the controller.

`bench tick` measures experiments with three and with six joints, which use different parts of the controller.
"""

import contextlib
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import numpy as np

import core.control.step as control_step
from station.config.controllers import PERIOD_S
from station.control import loop
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import run_case
from station.jobs.processes import Processes, processors
from station.jobs.run_jobs import run_jobs

#: Processor time between two samples of the running function [s].
SAMPLE_S = 1e-3


def headless(seconds: float = 20.0) -> dict[str, Any]:
    """Measure the speed of the case `feedforward` of `fig10` in virtual time: one run, then one on each processor."""
    _headless(2.0, lambda _: None)
    alone = sorted(_headless(seconds, lambda _: None) for _ in range(3))
    shares = share_by_folder(lambda: _headless(seconds, lambda _: None))
    tick_us = 1e6 * PERIOD_S / alone[1]
    count = processors()
    parallel = dict[int, float]()
    with Processes(count) as started:
        for duration in (2.0, seconds):
            parallel.clear()
            run_jobs(_headless, dict.fromkeys(range(count), duration), started, parallel)
    return {
        "times_real_time": round(alone[1], 2), "min": round(alone[0], 2), "max": round(alone[2], 2),
        "tick_us": {folder: round(share * tick_us, 1) for folder, share in shares.items()},
        "side_by_side": {"processes": count, "times_real_time": round(sum(parallel.values()), 2)},
    }  # fmt: skip


def share_by_folder(work: Callable[[], object]) -> dict[str, float]:
    """Carry out `work` and return the shares of its processor time by folder of the project, the largest first.

    Compiled code and libraries count for the function that calls them.
    """
    counts = Counter[str]()

    def sample(_: int, frame: FrameType | None) -> None:
        while frame is not None:
            package, *rest = frame.f_globals.get("__name__", "").split(".")
            if package in ("core", "station") and rest:
                counts[f"{package}/{rest[0]}"] += 1
                return
            frame = frame.f_back

    before = signal.signal(signal.SIGPROF, sample)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
    try:
        work()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return {folder: count / counts.total() for folder, count in counts.most_common()}


def _headless(duration: float, _: Callable[[float], None]) -> float:
    """Run the case for `duration` [s] and return its speed relative to real time."""
    case = next(case for case in load_experiment("fig10").cases if case.name == "feedforward")
    file = case.file.model_copy(update={"duration": duration})
    run = run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
    return run.simulated_s / run.wall_s


#: Timed cases by the key of their result: three joints; six joints with position only, direction, null-space goals.
TICK_CASES = {
    "step_us": ("fig10", "feedforward"),
    "six_joints_step_us": ("points", "position_alone"),
    "six_joints_pointing_step_us": ("points", "pointing_alone"),
    "six_joints_spare_step_us": ("points", "pointing"),
}


def tick(seconds: float = 20.0) -> dict[str, Any]:
    """Run each of `TICK_CASES` for `seconds` after a warm-up; return the times of a tick [us].

    In a tick the controller fuses and filters the forces, observes the tip, solves the model twice, and computes and
    limits the joint velocities. Between two ticks the virtual lab and the telemetry run. They displace data from the
    processor's cache, as the drivers and the telemetry of a real rig do.
    """
    found: dict[str, Any] = {"ticks": round(seconds * 500)}
    for key, (experiment, name) in TICK_CASES.items():
        found[key] = _tick(next(case for case in load_experiment(experiment).cases if case.name == name), seconds)
    return found


@contextlib.contextmanager
def timed_steps() -> Iterator[list[float]]:
    """Provide a list that collects the duration of each step of the controller in this process [s]."""
    taken: list[float] = []

    def timed(*arguments: Any) -> control_step.Tick:
        start = time.perf_counter()
        result = control_step.step(*arguments)
        taken.append(time.perf_counter() - start)
        return result

    loop.step = timed
    try:
        yield taken
    finally:
        loop.step = control_step.step


def _tick(case: Case, seconds: float) -> dict[str, float]:
    with timed_steps() as taken:
        for duration in (2.0, seconds):
            taken.clear()
            file = case.file.model_copy(update={"duration": duration})
            run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
    # Only ticks of the motion count: during its preparation the controller does not compute the inverse kinematics.
    moving = 1e6 * np.array(taken[-int(seconds * 500) :])
    part = np.percentile(moving, [50, 99, 99.9])
    return dict(zip(("median", "p99", "p99_9"), np.round(part, 1).tolist(), strict=True))
