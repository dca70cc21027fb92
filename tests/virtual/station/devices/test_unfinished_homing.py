"""Stages whose driver was killed while they homed need homing again, whatever the device reports, for every driver."""

import copy
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.config.robots import load_robot
from station.devices.interfaces import Condition
from station.lab.simulated_line import SimulatedStages
from station.lab.wires import HostPort
from tests.harness.stages_bench import KINDS, StagesBench

#: Joints near their home sensors, so that homing is short. The second rotation is below its zero and turns back.
START = (0.05, -0.03, -0.128)
#: Factor on the speed of the joints, and time between two polls [s]: a turn takes fewer polls.
FASTER, POLL_S = 3.0, 0.004
#: Polls between two copies of the devices.
COPIED = 5


class Homing(NamedTuple):
    """A homing of homed stages, with copies of the devices as they were during it."""

    bench: StagesBench
    before: np.ndarray  #: true joint positions at its start [rad or m]
    after: np.ndarray  #: and at its end
    copies: Sequence[tuple[float, SimulatedStages]]  #: times [s] and devices


@cache
def homing(kind: str) -> Homing:
    paper = load_robot("paper")
    joints = tuple(joint.model_copy(update={"speed": FASTER * joint.speed}) for joint in paper.joints)
    bench = StagesBench(paper.model_copy(update={"joints": joints}), kind, START).connect()
    assert bench.stages.ready, bench.cause
    before, copies, polls = bench.positions, [(bench.now, copy.deepcopy(bench.simulated))], 0
    bench.stages.home(bench.now)
    while bench.stages.condition is Condition.HOMING:
        bench.stages.poll(bench.now)
        bench.let_pass(POLL_S)
        polls += 1
        if polls % COPIED == 0:
            copies.append((bench.now, copy.deepcopy(bench.simulated)))
    assert bench.stages.ready, bench.cause
    assert (bench.positions != before).all()
    return Homing(bench, before, bench.positions, copies)


@pytest.mark.parametrize("kind", list(KINDS))
@settings(max_examples=4, derandomize=True)
@given(
    at=st.floats(0.0, 1.0), pause=st.sampled_from((0.0, 0.5, 30.0)), power=st.sampled_from((None, None, 1, 2, 3)),
    starts=st.integers(1, 2),
)  # fmt: skip
def test_stages_are_not_ready_after_a_kill_while_they_home(kind, at, pause, power, starts):
    known = homing(kind)
    bench, moment = copy.copy(known.bench), int(at * (len(known.copies) - 1))
    bench.now, bench.simulated = known.copies[moment][0], copy.deepcopy(known.copies[moment][1])
    bench.host = HostPort(kind)
    bench.let_pass(pause)  # some stages complete their motion without the driver
    if power is not None:
        bench.simulated.power_cycle(power)
        bench.let_pass(1.0)
    bench.let_pass()
    bench.host = HostPort(kind)  # bytes that were sent while no driver was running are lost
    for _ in range(starts):
        bench.stages = KINDS[kind].on(bench.host, bench.robot)
        bench.connect()
        assert bench.stages.condition is Condition.CONNECTED, bench.cause
        bench.run(0.1)
        if bench.stages.ready:  # only before the first motion, or after the last axis is home
            assert power is None
            assert any(bench.positions == pytest.approx(place, abs=2e-5) for place in (known.before, known.after))
            assert bench.reading.positions == pytest.approx(bench.positions, abs=2e-5)
