"""`ctr-station bench tick`: computing time of one whole tick of the controller, measured in the control loop.

    ctr-station bench tick

In a tick the controller fuses and filters the forces, observes the tip, solves the model twice, and computes and
limits the joint velocities. Between two ticks the virtual lab and the telemetry run, so they displace data from the
processor's cache, as the drivers and the telemetry of a real rig do.
"""

import time
from typing import Any

import numpy as np
from rich.console import Console

import core.control.step as control_step
from station.benchmarks.bench import table
from station.control import loop
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import run_case

#: Timed cases, by result: three joints; six joints: position only, with direction, and with null-space objectives.
CASES = {
    "step_us": ("fig10", "feedforward"),
    "six_joints_step_us": ("points", "position_alone"),
    "six_joints_pointing_step_us": ("points", "pointing_alone"),
    "six_joints_spare_step_us": ("points", "pointing"),
}


def tick(seconds: float = 20.0) -> dict[str, Any]:
    """Run each of `CASES` for `seconds` after a warm-up; return the times of a tick [us]."""
    found: dict[str, Any] = {"ticks": round(seconds * 500)}
    for key, (experiment, name) in CASES.items():
        found[key] = _tick(next(case for case in load_experiment(experiment).cases if case.name == name), seconds)
    return found


def _tick(case: Case, seconds: float) -> dict[str, float]:
    taken: list[float] = []

    def timed(*arguments: Any) -> control_step.Tick:
        start = time.perf_counter()
        result = control_step.step(*arguments)
        taken.append(time.perf_counter() - start)
        return result

    loop.step = timed
    try:
        for duration in (2.0, seconds):
            taken.clear()
            file = case.file.model_copy(update={"duration": duration})
            run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
    finally:
        loop.step = control_step.step
    # Only ticks of the motion count: during its preparation the controller does not compute the inverse kinematics.
    moving = 1e6 * np.array(taken[-int(seconds * 500) :])
    part = np.percentile(moving, [50, 99, 99.9])
    return dict(zip(("median", "p99", "p99_9"), np.round(part, 1).tolist(), strict=True))


if __name__ == "__main__":
    Console(highlight=False).print(table("tick", tick()))
