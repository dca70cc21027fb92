"""The stages stop in every cell of the table: ending of the station, kind of stages, motion.

Several hours: choose cells with `-k`. Each cell prints the time from the ending to the last step.
"""

import signal
import sys
from itertools import product
from pathlib import Path

import pytest

from station.lab.simulated_stages import STAGES
from tests.harness.endings import DEADLY, ENDINGS, HARMLESS, OF_CALIBRATIONS
from tests.harness.mortal_station import HELPERS, MOTIONS, mortal_station, moving
from tests.harness.watched_lab import WatchedLab


def words(value: object) -> str:
    return str(value).replace(" ", "-")


ALL = product(ENDINGS, STAGES, MOTIONS)
CELLS = [cell for cell in ALL if cell[0] not in OF_CALIBRATIONS or cell[2] == "calibration"]


@pytest.mark.parametrize(("ending", "stages", "motion"), CELLS, ids=words)
def test_stages_stop_however_the_station_ends(ending: str, stages: str, motion: str, tmp_path: Path) -> None:
    lab_name = "breathing" if motion == "follow" else "gentle"
    with WatchedLab(stages=stages, lab=lab_name) as lab, mortal_station(lab, tmp_path) as station:
        begin = moving(station, motion)
        ENDINGS[ending](station)
        sys.stdout.write(f"last step after {lab.rest_after(begin):.3f} s: {ending}, {stages}, {motion}\n")


@pytest.mark.parametrize("name", [name for name in HELPERS if name != "guard"])
@pytest.mark.parametrize("number", DEADLY, ids=words)
def test_stages_stop_after_any_deadly_signal_to_one_process(number: signal.Signals, name: str, tmp_path: Path) -> None:
    with WatchedLab() as lab, mortal_station(lab, tmp_path) as station:
        begin = moving(station, "motion")
        station.signal(number, name)
        if number in (signal.SIGINT, signal.SIGHUP):
            assert station.status()["state"] == "RUNNING"  # only the station process heeds these
        else:
            sys.stdout.write(f"last step after {lab.rest_after(begin):.3f} s: {number.name} to {name}\n")


def test_harmless_signals_to_all_processes_and_deadly_ones_to_the_guard_end_nothing(tmp_path: Path) -> None:
    with WatchedLab() as lab, mortal_station(lab, tmp_path) as station:
        moving(station, "motion")
        for number in HARMLESS:
            station.signal(number, *station.processes)
        for number in DEADLY:
            if number is not signal.SIGTERM:
                station.signal(number, "guard")
        assert station.status()["state"] == "RUNNING"
        assert all(process.is_running() for process in station.processes.values())
        assert station.rest.post("/api/stop").status_code == 200
