"""Late ticks of the control loop (overruns) that end a motion."""

import pytest

from station.control.overruns import OverrunLimits, Overruns
from station.devices.interfaces import Severity

PERIOD = 0.002


def late(overruns: Overruns, skips: list[int], start: float = 0.0) -> list[Severity | None]:
    """Return the severity of the fault after each tick; a tick lasts its period and the skipped periods."""
    found, now = [], start
    for skipped in skips:
        now += skipped * PERIOD
        trouble = overruns.check(now, skipped)
        found.append(None if trouble is None else trouble.severity)
        now += PERIOD
    return found


@pytest.fixture
def overruns():
    return Overruns(OverrunLimits(), PERIOD)


def test_punctual_loop_causes_no_fault(overruns):
    assert late(overruns, [0] * 10_000) == [None] * 10_000


def test_five_overruns_in_a_row_cause_hold_and_twenty_cause_fault(overruns):
    found = late(overruns, [1] * 20)

    assert found[:4] == [None] * 4
    assert found[4:19] == [Severity.HOLD] * 15
    assert found[19] is Severity.FAULT


def test_punctual_tick_resets_the_number_of_consecutive_overruns(overruns):
    assert late(overruns, [1, 1, 1, 1, 0] * 5) == [None] * 25


def test_more_than_one_percent_of_skipped_periods_in_ten_seconds_causes_hold(overruns):
    # In 10 s there are 5000 periods, so 50 skipped periods are one percent.
    assert late(overruns, [0, 25] * 2) == [None] * 4
    assert late(overruns, [0, 1], start=1.0) == [None, Severity.HOLD]


def test_overruns_older_than_ten_seconds_do_not_count(overruns):
    late(overruns, [25, 0, 25, 0])

    assert late(overruns, [1, 0], start=10.2) == [None, None]


def test_overruns_before_a_motion_do_not_count(overruns):
    late(overruns, [25, 0, 25, 0, 1])
    overruns.forget()

    assert late(overruns, [1, 0], start=1.0) == [None, None]


def test_overrun_thresholds_are_those_of_the_station_file():
    overruns = Overruns(OverrunLimits(hold_in_a_row=2, fault_in_a_row=3), PERIOD)

    assert late(overruns, [1, 1, 1]) == [None, Severity.HOLD, Severity.FAULT]


def test_overrun_fault_has_the_number_of_late_ticks_and_an_instruction(overruns):
    for _ in range(4):
        overruns.check(0.0, 1)
    trouble = overruns.check(0.0, 1)

    assert trouble is not None
    assert "late 5 times in a row" in trouble.text
    assert "doctor" in trouble.text
