"""Run one circle for hours of virtual time while the force sensors drift.

`python -m tests.tools.long_drift [--hours 8] [--lab realistic] [--seed 31]` prints one line per 30 minutes: the
state, the largest true distance of the tip in that time, the filtered force, the resident memory, and the cause of a
HOLD or STOP. Eight hours take about 80 minutes of one processor.
"""

import argparse
import resource

import numpy as np

from station.config.motions import CircleMotion
from station.control.states import State
from station.experiments.experiment import load_experiment
from tests.harness.virtual_station import VirtualStation

CHUNK_S = 1800.0
CIRCLE = CircleMotion(radius=0.010, period=20.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--lab", default="realistic")
    parser.add_argument("--seed", type=int, default=31)
    options = parser.parse_args()

    file = load_experiment("fig10", {"lab": options.lab})
    case = next(case for case in file.cases if case.name == "feedforward")
    station = VirtualStation(case, seed=options.seed)
    station.moving(CIRCLE, duration=3600.0 * options.hours + 60.0, since=10.0)
    for chunk in range(1, round(3600.0 * options.hours / CHUNK_S) + 1):
        largest, force, end = 0.0, np.zeros(3), station.now + CHUNK_S
        while station.now < end and station.state is State.RUNNING:
            station.rows.clear()
            station.seconds(5.0)
            distance = station.of("tip_true") - station.of("tip_desired")
            largest = max(largest, float(np.linalg.norm(distance, axis=1).max()))
            force = station.of("force_filtered")[-1]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(  # noqa: T201
            f"{chunk * CHUNK_S / 3600.0:5.1f} h  {station.state.name}  {1e3 * largest:6.2f} mm  "
            f"{np.linalg.norm(force):5.3f} N  {memory:6.0f} MB  {station.loop.cause}",
            flush=True,
        )
        if station.state is not State.RUNNING:
            return


if __name__ == "__main__":
    main()
