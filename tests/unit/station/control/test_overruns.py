"""When lateness ends a motion."""

import pytest

from station.control.overruns import OverrunLimits, Overruns
from station.devices.interfaces import Severity

PERIOD = 0.002


def late(overruns: Overruns, skips: list[int], begin: float = 0.0) -> list[Severity | None]:
    """What each tick leads to; a tick takes its period and the skipped ones."""
    found, now = [], begin
    for skipped in skips:
        now += skipped * PERIOD
        trouble = overruns.look(now, skipped)
        found.append(None if trouble is None else trouble.severity)
        now += PERIOD
    return found


@pytest.fixture
def overruns():
    return Overruns(OverrunLimits(), PERIOD)


def test_a_punctual_loop_is_left_alone(overruns):
    assert late(overruns, [0] * 10_000) == [None] * 10_000


def test_five_in_a_row_hold_and_twenty_are_a_fault(overruns):
    found = late(overruns, [1] * 20)

    assert found[:4] == [None] * 4
    assert found[4:19] == [Severity.HOLD] * 15
    assert found[19] is Severity.FAULT


def test_a_punctual_tick_between_begins_the_row_anew(overruns):
    assert late(overruns, [1, 1, 1, 1, 0] * 5) == [None] * 25


def test_more_than_one_percent_of_ten_seconds_holds(overruns):
    # 50 of 5000 periods are one percent
    assert late(overruns, [0, 25] * 2) == [None] * 4
    assert late(overruns, [0, 1], begin=1.0) == [None, Severity.HOLD]


def test_what_was_missed_ten_seconds_ago_is_forgotten(overruns):
    late(overruns, [25, 0, 25, 0])

    assert late(overruns, [1, 0], begin=10.2) == [None, None]


def test_what_was_late_before_a_motion_does_not_count(overruns):
    late(overruns, [25, 0, 25, 0, 1])
    overruns.forget()

    assert late(overruns, [1, 0], begin=1.0) == [None, None]


def test_the_thresholds_are_the_station_s():
    overruns = Overruns(OverrunLimits(hold_in_a_row=2, fault_in_a_row=3), PERIOD)

    assert late(overruns, [1, 1, 1]) == [None, Severity.HOLD, Severity.FAULT]


def test_what_is_said_names_the_number_and_what_to_do(overruns):
    for _ in range(4):
        overruns.look(0.0, 1)
    trouble = overruns.look(0.0, 1)

    assert trouble is not None
    assert "late 5 times in a row" in trouble.text
    assert "doctor" in trouble.text
