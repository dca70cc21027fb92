"""Delays of setpoints, computed from synthetic times without a clock."""

import numpy as np
import pytest

from station.benchmarks.setpoints import UsedSetpoint, delays, figures, on_the_line
from station.devices.zaber.protocol import MESSAGE_TIME_S


def used(setpoint: list[int], received: list[float], desired: list[int], sent: list[int]) -> UsedSetpoint:
    """Return ticks of one axis at intervals of 2 ms; the first tick is at 1 s."""
    count = len(setpoint)
    columns = np.array(desired)[:, None], np.array(sent)[:, None]
    return UsedSetpoint(1.0 + 0.002 * np.arange(count), np.array(setpoint), np.array(received), *columns)


def test_delay_of_a_setpoint_has_parts_for_server_tick_and_line():
    ticks = used([-1, 0, 0, 0, 0], [0.0, *4 * [1.0015]], [5, 7, 8, 9, 9], [5, 5, 5, 5, 9])
    found = delays(np.array([1.0005]), ticks, [np.array([0.9, 1.0063, 1.03])])

    assert found.hearing == pytest.approx([0.0010])
    assert found.tick == pytest.approx([0.0005])  # the tick at 1.002 s uses the setpoint that was received at 1.0015 s
    assert found.line == pytest.approx([0.0043])  # sent in the tick at 1.006 s; the line starts to transmit at 1.0063 s
    assert found.whole == pytest.approx([0.0058])


def test_line_delay_is_measured_for_each_axis():
    one = used([0, 0, 0, 0], 4 * [0.999], [2, 3, 3, 3], [1, 1, 3, 3])
    ticks = one._replace(
        desired=np.hstack((one.desired, [[1], [1], [1], [1]])), sent=np.array([[1, 0], [1, 0], [3, 0], [3, 1]])
    )
    found = delays(np.array([0.998]), ticks, [np.array([1.0022]), np.array([1.0049])])

    assert found.line == pytest.approx([0.0022, 0.0049])


def test_setpoint_replaced_before_a_tick_is_not_counted():
    ticks = used([0, 2, 2], [0.9995, 1.001, 1.001], [2, 3, 4], [1, 2, 3])
    found = delays(np.array([0.999, 1.0003, 1.0007]), ticks, [np.array([1.0001, 1.0021])])

    assert found.hearing == pytest.approx([0.0005, 0.0003])


def test_axis_without_a_new_velocity_is_not_counted():
    ticks = used([0, 0, 0, 0], 4 * [0.999], [5, 5, 6, 6], [5, 5, 5, 6])
    assert delays(np.array([0.998]), ticks, [np.array([1.0041])]).whole.size == 0


def test_setpoints_without_a_later_message_are_not_counted():
    ticks = used([0, 0], 2 * [0.999], [5, 5], [1, 1])
    found = delays(np.array([0.998]), ticks, [np.array([])])

    assert found.whole.size == 0
    assert figures(found)["whole_ms"] == {"median": None, "p99": None, "max": None}


def test_line_sends_messages_one_after_the_other():
    starts = on_the_line(np.array([0.0, 0.001, 0.1]))
    assert starts == pytest.approx([0.0, MESSAGE_TIME_S, 0.1])


def test_figures_contain_the_whole_delay_and_each_part():
    ticks = used([0, 0, 0], 3 * [1.0], [2, 2, 2], [1, 1, 2])
    values = figures(delays(np.array([0.999]), ticks, [np.array([1.0025])]))

    assert values == {
        "whole_ms": {"median": 3.5, "p99": 3.5, "max": 3.5},
        "hearing_ms": {"median": 1.0, "p99": 1.0, "max": 1.0},
        "tick_ms": {"median": 0.0, "p99": 0.0, "max": 0.0},
        "line_ms": {"median": 2.5, "p99": 2.5, "max": 2.5},
    }
