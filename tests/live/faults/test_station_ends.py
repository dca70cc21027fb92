"""The stages stop however the station's terminal, parent or processes end, and a station is never suspended by a key.

The simulated stages themselves tell when they made their last step. `tests/thorough/test_station_ends.py` has every
ending with every kind of stages and motion.
"""

import sys
from pathlib import Path

import pytest

from tests.harness.endings import ENDINGS
from tests.harness.mortal_station import mortal_station, moving
from tests.harness.watched_lab import WatchedLab

#: A row of each kind: ending, stages, motion.
ROWS = [
    ("terminal closed", "zaber", "motion"),
    ("SIGUSR1 to the group", "grbl", "jog"),
    ("service ended", "zaber_ascii", "force"),
    ("SIGKILL to all but guard", "cia402", "homing"),
    ("SIGSTOP to all but recorder", "marlin", "calibration"),
    ("SIGKILL to all but calibrate", "zaber", "calibration"),
]


CAUSES = {
    "parent killed": "the program that started the station has ended, and all axes were stopped",
    "SIGKILL to guard": "the guard has ended or is suspended, so nothing may move; reset starts another guard",
}


@pytest.mark.parametrize(("ending", "stages", "motion"), ROWS, ids=lambda value: value.replace(" ", "-"))
def test_stages_stop_however_the_station_ends(ending: str, stages: str, motion: str, tmp_path: Path) -> None:
    with WatchedLab(stages=stages) as lab, mortal_station(lab, tmp_path) as station:
        begin = moving(station, motion)
        ENDINGS[ending](station)
        sys.stdout.write(f"last step after {lab.rest_after(begin):.3f} s: {ending}, {stages}, {motion}\n")


def test_a_key_suspends_no_station_and_the_end_of_its_parent_or_guard_stops_the_stages(tmp_path: Path) -> None:
    with WatchedLab() as lab, mortal_station(lab, tmp_path) as station:
        moving(station, "motion")
        station.press(b"\x1a")
        station.said_soon("ctr-station cannot be suspended")
        assert station.status()["state"] == "RUNNING"
        for ending, reset in (("parent killed", ""), ("SIGKILL to guard", "restarted: the guard")):
            ENDINGS[ending](station)
            station.ends_by(CAUSES[ending])
            assert station.rest.post("/api/reset").json()["note"] == reset
            station.becomes("READY")
            moving(station, "motion")
