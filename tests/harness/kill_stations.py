"""Kill the station's processes at random moments: `python -m tests.harness.kill_stations 20 [SEED [WHOM ...]]`.

Each time a run is on, one process gets kill -9, and it is measured how long it took until every stage had been told
to stop, on the stages' own side of the line.
"""

import os
import random
import signal
import statistics
import sys
import tempfile
from pathlib import Path

from station.control.realtime import ask_for_fifo
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.waiting import until
from tests.harness.watched_lab import WatchedLab

WHOM = ("control", "station", "recorder")


def until_moving(station: LoneStation, lab: WatchedLab | None = None) -> None:
    """Start a run and wait until it moves, and until the stages of a watched lab do."""
    assert station.ask("start")["refused"] == ""

    def moving() -> bool:
        status = station.ask("status")
        assert status["state"] == "RUNNING", status
        return status["phase"] == "MOVING" and (lab is None or lab.moving())

    until(moving)


def kill(station: LoneStation, lab: WatchedLab, whom: str, after: float) -> float:
    """Kill one of its processes `after` [s] of motion: the time until the last stage was told to stop [s]."""
    until_moving(station, lab)
    pid = station.process.pid if whom == "station" else station.child(whom).pid
    lab.clock.sleep(after)
    until(lab.moving)
    # Between the two lines nobody may take our turn.
    ask_for_fifo(60)
    begin = lab.clock.now()
    os.kill(pid, signal.SIGKILL)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return lab.told(begin)


def back(station: LoneStation) -> None:
    """READY again, after whatever it was."""

    def ready() -> bool:
        status = station.ask("status")
        if status["state"] in ("HOLD", "STOPPED", "FAULT"):
            station.ask("reset")
        return status["state"] == "READY"

    until(ready)


def main() -> None:
    """Kill each as often as the first argument says."""
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
                            break  # it is not started anew while the station lives
                        back(station)
            sys.stdout.write(
                f"{whom}: killed {times} times; every stage told to stop after"
                f" {1e3 * statistics.median(took):.0f} ms (median), {1e3 * max(took):.0f} ms at most\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
