"""Operator's browser closed: a jog stops at once."""

import numpy as np

from station.control.jog import ALIVE
from station.control.states import State
from tests.harness.virtual_station import VirtualStation


def test_a_jog_that_is_not_asked_for_any_more_ends_by_itself(virtual: VirtualStation) -> None:
    virtual.ready()
    for _ in range(10):
        virtual.loop.jog(virtual.now, "joints", np.array([0.05, 0.0, 0.0]))
        virtual.seconds(0.1)
    assert virtual.state is State.RUNNING
    begin = virtual.now
    virtual.becomes(State.READY)

    assert virtual.now - begin <= ALIVE  # 0.3 s since the last word
    virtual.seconds(0.1)
    assert virtual.rests()
