"""A lost serial link causes FAULT and stops the axes that can still be reached.

The cause names each axis that cannot be reached and how far it can travel. The next run requires homing.
"""

import re

import pytest

from station.control.states import RefusedError, State
from station.control.task import MotionTask
from tests.harness.virtual_station import AXES, VirtualStation

#: Longest time until a lost axis causes FAULT [s]: two polls without a reply, at 13 polls a second with 50 ms each.
NOTICED = 0.5


def reset_wants_homing(station: VirtualStation) -> None:
    """Reconnect the stages, reset, and check that the station requires homing before the next run."""
    station.mend()
    station.seconds(0.5)
    station.loop.reset(station.now)
    station.becomes(State.CONNECTED)
    station.seconds(1.0)
    assert station.state is State.CONNECTED, "not READY by itself, because the positions of the stages are unknown"
    with pytest.raises(RefusedError, match="it needs READY"):
        station.loop.start(MotionTask(station.case.controller, station.case.orders, 1.0))


def test_cut_cable_stops_the_reachable_axes_and_the_cause_names_the_other_axis_and_its_travel(
    virtual: VirtualStation,
) -> None:
    virtual.moving()
    virtual.fail(
        "disconnect", "inner_translation"
    )  # the last axis of the chain, so that the two axes before it still receive commands
    took = virtual.becomes(State.FAULT)
    virtual.seconds(0.4)

    assert took < NOTICED
    cause = virtual.loop.cause
    assert cause.startswith("the stage inner_translation cannot be reached; ")
    seen = re.search(r"last seen at (-?[\d.]+) mm", cause)
    ends = {float(end): float(way) for end, way in re.findall(r" to (-?[\d.]+) mm, ([\d.]+) mm away", cause)}
    assert seen is not None, cause
    assert all(abs(abs(end - float(seen[1])) - way) < 0.11 for end, way in ends.items())
    # The axis stops at an end of its travel, which was set in its unit at connect. Two ends are possible if the line
    # was lost while its direction changed.
    assert {-130.0, -5.0} >= set(ends)
    assert "outer_rotation" not in cause
    assert virtual.rests((0, 1))
    # The disconnected axis continues at its present speed; `test_zaber_losses.py` follows it to its end.
    assert not virtual.rests((2,))


def test_silent_stages_are_stopped_although_they_do_not_answer(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("mute", "stages")
    took = virtual.becomes(State.FAULT)
    virtual.seconds(0.4)

    assert took < NOTICED
    for axis in AXES:
        assert (
            f"the stage {axis} cannot be reached" in virtual.loop.cause
        )  # the axes are added to the cause one after the other, when each misses its polls
    assert virtual.rests()


def test_missing_serial_port_causes_fault_within_two_ticks(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("disconnect", "stages")
    took = virtual.becomes(State.FAULT)

    assert took <= 0.004
    assert "zaber is gone: unplugged" in virtual.loop.cause_details
    for axis in AXES:
        assert axis in virtual.loop.cause
    sent = len(virtual.rows)
    virtual.seconds(0.5)
    assert not virtual.of("velocity_commanded", virtual.rows[sent:]).any()
    reset_wants_homing(virtual)
