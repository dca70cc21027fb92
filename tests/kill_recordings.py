"""Kill the recorder at random moments and look at what is left: `python -m tests.kill_recordings 20 [SEED]`.

A telemetry ring is fed at 500 Hz, a real recorder process copies it, kill -9 ends it, and the recording
must open after recovery with every row that was older than 0.3 s at that moment, to the bit.
"""

import os
import random
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from core.robot import Array
from station.recording.label import Label
from station.recording.read import read_case
from station.recording.recorder import Recorder
from station.recording.recover import recover
from station.ring import Ring
from station.robots import RobotFile, load_robot
from station.telemetry import Channels

PERIOD = 0.002
POSE = np.array([0.0, np.pi / 2, -0.1])
#: What may be missing [s].
LOSS = 0.3


class Feed:
    """A ring with a writer that puts a row into it every 2 ms, as the control process does."""

    def __init__(self, robot: RobotFile) -> None:
        self.channels = Channels(robot.robot())
        self.ring = Ring(len(self.channels))
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="feed")

    def row(self, number: int) -> Array:
        """Row `number`: its time, a robot that can be drawn, and numbers that no other row has."""
        row = np.random.default_rng(number).normal(size=len(self.channels))
        row[0], row[1] = number * PERIOD, 4.0
        self.channels.of(row, "joints")[:] = POSE
        self.channels.of(row, "force_filtered")[:] = (0.2, 0.0, 0.0)
        return row

    def _run(self) -> None:
        start = time.monotonic()
        while not self._stopping.wait(max(0.0, start + self.ring.written * PERIOD - time.monotonic())):
            self.ring.write(self.row(self.ring.written))

    def __enter__(self) -> "Feed":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        self.ring.close(remove=True)


class Left(NamedTuple):
    """What a kill left behind."""

    lost: float  #: age of the newest row that was recovered, when the recorder was killed [s]
    rows: int


def kill_recorder(runs: Path, feed: Feed, robot: RobotFile, after: float) -> Left:
    """Record for `after` [s], kill, recover, and check all that was recovered."""
    recorder = Recorder(feed.ring, robot, runs)
    try:
        recorder.begin("killed", {"title": "to be killed"})
        first = feed.ring.written
        time.sleep(after)
        written = feed.ring.written
        os.kill(recorder.process.pid or 0, signal.SIGKILL)
        recorder.process.join()
        assert "signal 9" in recorder.trouble()
    finally:
        recorder.close()
    (folder,) = recover(runs)
    left = read_case(folder / "run.mcap")
    assert left.label is Label.INTERRUPTED
    start = round(left.rows[0, 0] / PERIOD)
    assert start <= first, "rows at the beginning are missing"
    expected = np.array([feed.row(start + number) for number in range(len(left.rows))])
    assert (left.rows == expected).all(), "rows differ from what was written"
    lost = (written - 1) * PERIOD - left.rows[-1, 0]
    assert lost <= LOSS, f"{lost:.3f} s are missing"
    return Left(lost, len(left.rows))


def main() -> None:
    """Kill as often as the first argument says."""
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    chance = random.Random(int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    robot = load_robot("paper")
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder, Feed(robot) as feed:
        for number in range(times):
            left = kill_recorder(Path(folder) / str(number), feed, robot, chance.uniform(0.3, 2.0))
            worst = max(worst, left.lost)
            print(f"{number + 1}: {left.rows} rows recovered, the last {1e3 * left.lost:.0f} ms of the run lost")
    print(f"{times} kills, every recording opens; at most {1e3 * worst:.0f} ms lost")


if __name__ == "__main__":
    main()
