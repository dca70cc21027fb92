"""Run one circle for hours of virtual time while the force sensors drift.

`python -m tests.harness.long_drift [--hours 8] [--lab realistic] [--seed 31]` prints one line per ten minutes: the
largest true distance of the tip in that time, the filtered force, the resident memory, and the cause of a HOLD or STOP.
"""

import argparse
import resource

import numpy as np

from station.config.motions import CircleMotion
from station.control.states import State
from station.experiments.experiment import load_experiment
from tests.harness.virtual_station import VirtualStation

CHUNK_S = 600.0
CIRCLE = CircleMotion(radius=0.010, period=20.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--lab", default="realistic")
    parser.add_argument("--seed", type=int, default=31)
    options = parser.parse_args()

    cases = load_experiment("fig10", {"lab": options.lab}).cases
    station = VirtualStation(next(case for case in cases if case.name == "feedforward"), seed=options.seed)
    station.moving(CIRCLE, duration=3600.0 * options.hours + 60.0, since=10.0)
    for chunk in range(1, round(3600.0 * options.hours / CHUNK_S) + 1):
        largest, force = 0.0, np.zeros(3)
        for _ in range(round(CHUNK_S / 10.0)):
            station.rows.clear()
            station.seconds(10.0)
            if station.state is not State.RUNNING:
                break
            distance = station.of("tip_true") - station.of("tip_desired")
            largest = max(largest, float(np.linalg.norm(distance, axis=1).max()))
            force = station.of("force_filtered")[-1]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(  # noqa: T201
            f"{chunk * CHUNK_S / 3600.0:5.2f} h  {station.state.name}  {1e3 * largest:6.2f} mm  "
            f"{np.linalg.norm(force):5.3f} N  {memory:6.0f} MB  {station.loop.cause}",
            flush=True,
        )
        if station.state is not State.RUNNING:
            return


if __name__ == "__main__":
    main()
