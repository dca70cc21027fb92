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
    assert station.state is State.CONNECTED, "not READY by itself: where the stage is now nobody knows"
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
    far = re.search(r"last seen at (-?[\d.]+) mm, it can run on to (-?[\d.]+) mm, ([\d.]+) mm away", cause)
    assert far is not None, cause
    at, end, way = (float(text) for text in far.groups())
    assert abs(abs(end - at) - way) < 0.11
    # The axis stops at an end of its travel, which was set in its unit at connect.
    assert end in (-130.0, -5.0)
    assert "outer_rotation" not in cause
    assert virtual.rests((0, 1))
    # The disconnected axis continues at its present speed to the position in the cause.
    before = virtual.places[2]
    virtual.seconds(1.0)
    speed = abs(virtual.places[2] - before)
    assert speed > 0.0
    virtual.until(lambda: virtual.rests((2,)), 1e-3 * way / speed + 1.0)
    assert virtual.places[2] * 1e3 == pytest.approx(end, abs=0.1)
    assert virtual.state is State.FAULT
    reset_wants_homing(virtual)
    virtual.loop.home(virtual.now)
    virtual.becomes(State.READY, 120.0)


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


def test_serial_line_that_loses_few_bytes_does_not_end_the_run(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("drop_bytes", "stages", value=0.0005)
    virtual.seconds(5.0)

    assert virtual.state is State.RUNNING
