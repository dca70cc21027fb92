"""Kill the station's processes at random times: `python -m tests.tools.kill_stations 20 [SEED [WHOM ...]]`.

Each time, one process is killed with SIGKILL during a run. The measured time ends when every stage has received a
command to stop, at the device's end of the line.
"""

import os
import random
import signal
import statistics
import sys
import tempfile
from pathlib import Path

from station.control.realtime import request_fifo
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.waiting import until
from tests.harness.watched_lab import WatchedLab

WHOM = ("control", "station", "recorder")


def until_moving(station: LoneStation, lab: WatchedLab | None = None) -> None:
    """Start a run and wait until the robot moves; with a watched lab also until its stages move."""
    assert (answer := station.ask("start"))["refused"] == "", answer

    def moving() -> bool:
        status = station.ask("status")
        assert status["state"] == "RUNNING", status
        return status["phase"] == "MOVING" and (lab is None or lab.moving())

    until(moving)


def kill(station: LoneStation, lab: WatchedLab, whom: str, after: float) -> float:
    """Kill one process of the station after `after` [s] of motion; return the time until all stages must stop [s]."""
    until_moving(station, lab)
    pid = station.process.pid if whom == "station" else station.child(whom).pid
    lab.clock.sleep(after)
    until(lab.moving)
    # With real-time priority no other program delays this process between the next two lines.
    request_fifo(60)
    begin = lab.clock.now()
    os.kill(pid, signal.SIGKILL)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return lab.stop_delay(begin)


def back(station: LoneStation) -> None:
    """Return the station to READY, whatever its state is."""

    def ready() -> bool:
        status = station.ask("status")
        if status["state"] in ("HOLD", "STOPPED", "FAULT"):
            station.ask("reset")
        return status["state"] == "READY"

    until(ready)


def main() -> None:
    """Kill each process as often as the first argument specifies."""
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    chance = random.Random(int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    with WatchedLab() as lab:
        for whom in sys.argv[3:] or WHOM:
            took: list[float] = []
            while len(took) < times:
                with tempfile.TemporaryDirectory() as folder, lone_station(Path(folder), lab) as station:
                    while len(took) < times:
                        took.append(kill(station, lab, whom, chance.uniform(0.1, 2.0)))
                        if whom != "control":
                            break  # the station does not start this process again
                        back(station)
            sys.stdout.write(
                f"{whom}: killed {times} times; every stage told to stop after"
                f" {1e3 * statistics.median(took):.0f} ms (median), {1e3 * max(took):.0f} ms at most\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
