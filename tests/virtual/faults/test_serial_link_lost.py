"""Serial link lost: the others stopped, FAULT, which axis and how far it can run; homed again before the next run."""

import re

import pytest

from station.control.states import RefusedError, State
from station.control.task import Task
from tests.harness.virtual_station import AXES, VirtualStation

#: Two replies are missed: each has 50 ms, and an axis is asked 13 times a second.
NOTICED = 0.5


def reset_wants_homing(station: VirtualStation) -> None:
    """What a person does afterwards, and what is asked of him."""
    station.mend()
    station.seconds(0.5)
    station.loop.reset(station.now)
    station.becomes(State.CONNECTED)
    station.seconds(1.0)
    assert station.state is State.CONNECTED, "not READY by itself: where the stage is now nobody knows"
    with pytest.raises(RefusedError, match="it needs READY"):
        station.loop.start(Task(station.case.controller, station.case.orders, 1.0))


def test_a_cut_cable_stops_the_others_and_says_which_axis_runs_on_and_how_far(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("disconnect", "inner_translation")  # the last of the chain: the two before it still hear
    took = virtual.becomes(State.FAULT)
    virtual.seconds(0.4)

    assert took < NOTICED
    cause = virtual.loop.cause
    assert "inner_translation (device 3 on zaber) cannot be reached" in cause
    far = re.search(r"last seen at (-?[\d.]+) mm, it can run on to (-?[\d.]+) mm, ([\d.]+) mm away", cause)
    assert far is not None, cause
    at, end, way = (float(text) for text in far.groups())
    assert abs(abs(end - at) - way) < 0.11
    # the travel of the stage: what was set in the unit at connect
    assert end in (-130.0, -5.0)
    assert "outer_rotation" not in cause
    assert virtual.rests((0, 1))
    # and the cut one does run on, as the text says
    assert not virtual.rests((2,))
    virtual.until(lambda: virtual.rests((2,)), 40.0)
    assert virtual.places[2] * 1e3 == pytest.approx(end, abs=0.1)
    assert virtual.state is State.FAULT
    reset_wants_homing(virtual)
    virtual.loop.home(virtual.now)
    virtual.becomes(State.READY, 120.0)


def test_units_that_do_not_answer_any_more_are_stopped_all_the_same(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("mute", "stages")
    took = virtual.becomes(State.FAULT)
    virtual.seconds(0.4)

    assert took < NOTICED
    for axis in AXES:
        assert f"{axis} (device" in virtual.loop.cause  # one after the other, as each is missed
    assert virtual.rests()


def test_a_port_that_is_gone_is_a_fault_in_the_next_tick(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("disconnect", "stages")
    took = virtual.becomes(State.FAULT)

    assert took <= 0.004
    assert "zaber is gone: unplugged" in virtual.loop.cause
    for axis in AXES:
        assert axis in virtual.loop.cause
    sent = len(virtual.rows)
    virtual.seconds(0.5)
    assert not virtual.of("velocity_commanded", virtual.rows[sent:]).any()
    reset_wants_homing(virtual)


def test_a_line_that_loses_bytes_is_no_lost_line(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("drop_bytes", "stages", value=0.0005)
    virtual.seconds(5.0)

    assert virtual.state is State.RUNNING
