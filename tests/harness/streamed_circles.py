"""A circle that a script streams, against the same circle as a trajectory, live.

`python -m tests.harness.streamed_circles [--seconds S]`

A usual station in real time, and a script that leads its tip at 10 places a second, a tenth of them lost, and at
50, 100 and 500. For each the distance of the true tip from its setpoint [mm], RMS and largest, and what was really
said a second; the trajectory before and after, as a measure of what differs by itself.
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
from station.bench.served import Served, served
from station.client import Station
from station.config.robots import load_robot
from station.control.ring import Ring
from station.control.task import Phase
from station.control.telemetry import Channels

#: The circle [m], [s].
RADIUS, TURN = 0.010, 20.0
#: Between two looks at the ring, which keeps 8 s [s].
LOOK = 1.0
#: Places a second, and which part of them is lost.
STREAMS = ((10.0, 0.1), (50.0, 0.0), (100.0, 0.0), (500.0, 0.0))


class Rows:
    """What the loop tells while something runs."""

    def __init__(self, ring: Ring, robot: Robot) -> None:
        self._ring, self._channels = ring, Channels(robot)
        self._since, self._rows = ring.written, list[Array]()

    def look(self) -> None:
        rows, self._since, _ = self._ring.read(self._since)
        self._rows.append(rows)

    def figures(self) -> dict[str, float]:
        """Of the rows in which the tip was moving."""
        self.look()
        rows, of = np.concatenate(self._rows), self._channels.of
        rows = rows[of(rows, "phase")[:, 0] == Phase.MOVING]
        away = 1e3 * np.linalg.norm(of(rows, "tip_true") - of(rows, "tip_desired"), axis=1)
        # The setpoint's own acceleration, over 20 ms.
        bent = np.diff(of(rows, "tip_desired")[::10], 2, axis=0) / 0.02**2
        return {
            "rms_mm": round(float(np.sqrt(np.mean(away**2))), 3),
            "largest_mm": round(float(away.max()), 3),
            "acceleration_mm_s2": round(1e3 * float(np.linalg.norm(bent, axis=1).max()), 1),
        }


def trajectory(station: Served, rows: Rows, seconds: float) -> dict[str, Any]:
    """The station knows the circle beforehand."""
    with Station(station.url) as script:
        motion = {"kind": "circle", "radius": RADIUS, "period": TURN, "normal": [0.0, 0.0, 1.0]}
        script.start(trajectory=motion, duration=seconds)
        while script.status()["state"] == "RUNNING":
            rows.look()
            time.sleep(LOOK)
        return {"as": "trajectory", **rows.figures()}


def streamed(station: Served, rows: Rows, seconds: float, rate: float, lost: float) -> dict[str, Any]:
    """A script tells it place by place."""
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
    """Print a JSON line for each."""
    parser = argparse.ArgumentParser(prog="python -m tests.harness.streamed_circles")
    parser.add_argument("--seconds", type=float, default=TURN)
    seconds, file = parser.parse_args().seconds, load_robot("paper")
    with tempfile.TemporaryDirectory() as folder, served(Path(folder), {}) as station, station.ring(file) as ring:
        ways = [trajectory, *(partial(streamed, rate=rate, lost=lost) for rate, lost in STREAMS), trajectory]
        for way in ways:
            with Station(station.url) as script:
                script.goto()
            sys.stdout.write(f"{json.dumps(way(station, Rows(ring, file.robot()), seconds))}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
