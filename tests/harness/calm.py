"""Station settings that let tests of live stations pass on a busy computer."""

from station.control.clock import StationClock

RATE = 0.5
#: A slow clock; and a busy computer may keep a simulated device silent for some time.
CLOCK = StationClock(RATE, patience=1.0)
#: Settings with this clock and without a limit on the control loop's lateness, because other programs also use the
#: processors.
SETTINGS = {
    "clock": {"rate": CLOCK.rate, "patience": CLOCK.patience},
    "overruns": {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000},
}
