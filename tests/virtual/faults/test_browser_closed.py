"""A jog ends 0.3 s after its last renewal, for example when the operator's browser is closed."""

import numpy as np

from station.control.states import State
from station.control.task import JOG_TIMEOUT_S
from tests.harness.virtual_station import VirtualStation


def test_jog_that_is_not_renewed_ends_by_itself(virtual: VirtualStation) -> None:
    virtual.ready()
    for _ in range(10):
        virtual.loop.jog(virtual.now, "joints", np.array([0.05, 0.0, 0.0]))
        virtual.seconds(0.1)
    assert virtual.state is State.RUNNING
    begin = virtual.now
    virtual.becomes(State.READY)

    assert virtual.now - begin <= JOG_TIMEOUT_S  # the timeout counts from the last renewal
    virtual.seconds(0.1)
    assert virtual.rests()
