"""What keeps tests of live stations calm, whatever else the computer does."""

from station.control.clock import StationClock

RATE = 0.5
#: A clock that leaves the processors time, and no limit on how late the loop may be: others have the processors, too.
SETTINGS = {
    "clock": {"rate": RATE, "patience": 1.0},
    "overruns": {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000},
}
CLOCK = StationClock(RATE)
