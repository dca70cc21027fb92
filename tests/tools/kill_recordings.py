"""Kill processes at random times and check the recordings: `python -m tests.tools.kill_recordings VICTIM 20 [SEED]`.

With VICTIM `recorder`, a telemetry ring is written at 500 Hz, and a real recorder process copies it and is killed with
SIGKILL. The recovered rows are compared with the written rows. With `control`, `station` or `all`, one
process of a real station with a run, or all of them at once, are killed. Every recording must open. The output is the
missing time of each recording, which should be no more than 0.3 s.
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
import psutil
from mcap.reader import make_reader

from core.robot.robot import Array
from station.config.robots import RobotFile, load_robot
from station.control.ring import Ring
from station.control.telemetry import Channels
from station.recording.read import open_case, read_case
from station.recording.recorder import Recorder
from station.recording.recover import recover
from station.recording.run_outcome import RunOutcome
from tests.harness.recordings import as_recorded
from tests.harness.serving import serving
from tests.harness.waiting import until

PERIOD = 0.002
POSE = np.array([0.0, np.pi / 2, -0.1])
#: Names of the processes that a station starts, as the system lists them.
CHILDREN = ("ctr-control", "ctr-guard", "ctr-lab", "ctr-recorder")


class Feed:
    """A telemetry ring and a thread that writes a row into it every 2 ms, as the control process does."""

    def __init__(self, robot: RobotFile) -> None:
        self.channels = Channels(robot.robot())
        self.ring = Ring(len(self.channels))
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="feed")

    def row(self, number: int) -> Array:
        """Return row `number`: its time, a robot that can be drawn, and values that no other row has."""
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
    """Result of recovering a recording after its recorder was killed."""

    lost: float  #: age of the newest recovered row at the time of the kill [s]
    rows: int


def kill_recorder(runs: Path, feed: Feed, robot: RobotFile, after: float) -> Left:
    """Record for `after` [s], kill the recorder, recover the recording, and check every recovered row."""
    recorder = Recorder(feed.ring, robot, runs)
    try:
        recorder.begin("killed", {"title": "to be killed"})
        first = feed.ring.written
        partial = runs / "killed.partial" / "run.mcap.partial"
        begun = partial.stat().st_size
        until(lambda: partial.stat().st_size > begun)  # the first rows are written; no time is asserted
        time.sleep(after)
        written = feed.ring.written
        os.kill(recorder.child.pid, signal.SIGKILL)
        recorder.child.ended()
        assert "signal 9" in recorder.trouble()
    finally:
        recorder.close()
    (folder,) = recover(runs).folders
    left = read_case(folder / "run.mcap")
    assert left.label is RunOutcome.INTERRUPTED, (left.label, left.cause)
    start = round(left.rows[0, 0] / PERIOD)
    assert start <= first, "rows at the beginning are missing"
    expected = np.array([feed.row(start + number) for number in range(len(left.rows))])
    assert (left.rows == as_recorded(expected, left.channels)).all(), "rows differ from what was written"
    lost = (written - 1) * PERIOD - left.rows[-1, 0]
    return Left(lost, len(left.rows))


def kill_station(data: Path, victim: str, after: float) -> Left:
    """Start a station and a run, kill one process or all of them, recover the recording, and check it."""
    with serving("--data", str(data), rate=None) as station:
        station.ready()
        body = {"trajectory": {"kind": "circle", "radius": 0.005, "period": 5.0}, "duration": 60.0}
        assert station.post("/api/start", body).status_code == 202
        time.sleep(after)
        everybody = [psutil.Process(station.process.pid), *(station.child(name) for name in CHILDREN)]
        victims = {"control": everybody[1:2], "station": everybody[:1], "all": everybody}[victim]
        killed = time.time()
        for process in victims:
            process.kill()
        if victim in ("station", "all"):
            station.process.wait()
            psutil.wait_procs(everybody, 20.0)
    recover(data)
    recordings = sorted(data.glob("*/run.mcap*"))
    assert len(recordings) == 1, [str(path) for path in data.rglob("*")]
    (folder,) = (path.parent for path in recordings)
    with open_case(folder / "run.mcap") as left:
        assert left.label is RunOutcome.INTERRUPTED, (left.label, left.cause)
        rows = np.concatenate(list(left.blocks()))
    assert (np.diff(rows[:, 0]) > 0.0).all()
    with (folder / "run.mcap").open("rb") as file:
        statistics = make_reader(file).get_summary()
    assert statistics is not None
    assert statistics.statistics is not None
    lost = killed - statistics.statistics.message_end_time / 1e9
    return Left(lost, len(rows))


def main() -> None:
    """Kill the process that the first argument names as often as the second argument specifies."""
    victim = sys.argv[1] if len(sys.argv) > 1 else "recorder"
    times = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    chance = random.Random(int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    robot = load_robot("paper")
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder, Feed(robot) as feed:
        for number in range(times):
            place, after = Path(folder) / str(number), chance.uniform(0.3, 3.0)
            if victim == "recorder":
                left = kill_recorder(place, feed, robot, after)
            else:
                left = kill_station(place, victim, after)
            worst = max(worst, left.lost)
            sys.stdout.write(f"{number + 1}: {left.rows} rows, the last {1e3 * left.lost:.0f} ms of the run lost\n")
            sys.stdout.flush()
    sys.stdout.write(f"{times} kills of {victim}: every recording opens; at most {1e3 * worst:.0f} ms lost\n")


if __name__ == "__main__":
    main()
