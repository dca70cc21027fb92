"""Compare a circle that a script streams with the same circle as a trajectory, on a live station.

`python -m tests.tools.streamed_circles [--seconds S]`

The station runs in real time. A script streams setpoints at 10 Hz with a tenth of them lost, and at 50, 100 and 500 Hz.
For each rate the output has the distance of the true tip from its setpoint [mm], RMS and largest, and the rate that was
really reached. The trajectory runs before and after the streams, to show the variation between equal runs.
"""

import argparse
import json
import math
import random
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from core.robot.robot import Array, Robot
from station.benchmarks.served import ServedStation, serve_station
from station.client import Station
from station.config.robots import load_robot
from station.control.ring import Ring
from station.control.task import Phase
from station.control.telemetry import Channels

#: Radius [m] and period [s] of the circle.
RADIUS, TURN = 0.010, 20.0
#: Interval between two readings of the telemetry ring, which keeps 8 s [s].
LOOK = 1.0
#: Rate of the setpoints [1/s], and the share of them that is lost.
STREAMS = ((10.0, 0.1), (50.0, 0.0), (100.0, 0.0), (500.0, 0.0))


class Rows:
    """Telemetry rows of the control loop during one run."""

    def __init__(self, ring: Ring, robot: Robot) -> None:
        self._ring, self._channels = ring, Channels(robot)
        self._since, self._rows = ring.written, list[Array]()

    def look(self) -> None:
        rows, self._since, _ = self._ring.read(self._since)
        self._rows.append(rows)

    def figures(self) -> dict[str, float]:
        """Return the errors over the rows in which the tip was moving."""
        self.look()
        rows, of = np.concatenate(self._rows), self._channels.of
        rows = rows[of(rows, "phase")[:, 0] == Phase.MOVING]
        away = 1e3 * np.linalg.norm(of(rows, "tip_true") - of(rows, "tip_desired"), axis=1)
        # Acceleration of the setpoint over 20 ms.
        bent = np.diff(of(rows, "tip_desired")[::10], 2, axis=0) / 0.02**2
        return {
            "rms_mm": round(float(np.sqrt(np.mean(away**2))), 3),
            "largest_mm": round(float(away.max()), 3),
            "acceleration_mm_s2": round(1e3 * float(np.linalg.norm(bent, axis=1).max()), 1),
        }


def trajectory(station: ServedStation, rows: Rows, seconds: float) -> dict[str, Any]:
    """Measure the circle as a trajectory, which the station knows in advance."""
    with Station(station.url) as script:
        motion = {"kind": "circle", "radius": RADIUS, "period": TURN, "normal": [0.0, 0.0, 1.0]}
        script.start(trajectory=motion, duration=seconds)
        while script.status()["state"] == "RUNNING":
            rows.look()
            time.sleep(LOOK)
        return {"as": "trajectory", **rows.figures()}


def streamed(station: ServedStation, rows: Rows, seconds: float, rate: float, lost: float) -> dict[str, Any]:
    """Measure the circle as a stream of setpoints from a script."""
    drawn, said, looked = random.Random(1), 0, 0.0
    with Station(station.url) as script, script.setpoints() as tip:
        for now in tip.every(1.0 / rate, seconds):
            if drawn.random() >= lost:
                turn = 2.0 * math.pi * now / TURN
                tip.go(RADIUS * (math.cos(turn) - 1.0), RADIUS * math.sin(turn), 0.0)
                said += 1
            if now - looked > LOOK:
                looked = now
                rows.look()
    return {"as": f"{rate:g}/s, {lost:.0%} lost", "a_second": round(said / seconds, 1), **rows.figures()}


def main() -> None:
    """Measure every run and print a JSON line for each."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.streamed_circles")
    parser.add_argument("--seconds", type=float, default=TURN)
    seconds, file = parser.parse_args().seconds, load_robot("paper")
    with (
        tempfile.TemporaryDirectory() as folder,
        serve_station(Path(folder), {}) as station,
        station.ring(file) as ring,
    ):
        ways = [trajectory, *(partial(streamed, rate=rate, lost=lost) for rate, lost in STREAMS), trajectory]
        for way in ways:
            with Station(station.url) as script:
                script.goto()
            sys.stdout.write(f"{json.dumps(way(station, Rows(ring, file.robot()), seconds))}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
