"""A STOP or a failed device, while the tubes move near a region, does not bring them nearer to it.

A cut line to the stages is not part of the test: stages that no command reaches keep their last velocity.
"""

from collections.abc import Callable

import pytest

from station.config.loads import RampLoad
from station.config.motions import CircleMotion
from station.config.regions import CapsuleRegion, keep_out
from station.control.states import State, Transition
from tests.harness.true_clearance import CONTROLLER, ROBOT, true_clearance
from tests.harness.virtual_station import VirtualStation, usual_case

CIRCLE = CircleMotion(radius=0.006, period=12.0)
PUSH = RampLoad(times=(0.0, 1.0), magnitudes=(0.0, 0.1))
#: A rib that the circle would touch without the limit, under the load.
RIB = CapsuleRegion(name="rib", start=(0.0144, -0.04, 0.1285), end=(0.0144, 0.01, 0.1285), radius=0.004)
LIMITS = keep_out([RIB])

FAILURES: dict[str, Callable[[VirtualStation], None]] = {
    "STOP": lambda virtual: virtual.loop.stop(virtual.now),
    "HOLD": lambda virtual: virtual.loop.stop(virtual.now, Transition.HOLD, "requested"),
    "lost tool": lambda virtual: virtual.fail("lose_tool", "tracker"),
    "silent tracker": lambda virtual: virtual.fail("mute", "tracker"),
    "silent sensors": lambda virtual: virtual.fail("mute", "sensors"),
    "frozen sensors": lambda virtual: virtual.fail("freeze", "sensors"),
}


@pytest.mark.parametrize("failure", ["STOP", "lost tool", "frozen sensors"])
def test_tubes_come_no_nearer_to_a_region_after(failure: str) -> None:
    check_failure(failure)


def check_failure(failure: str) -> None:
    """Check that the tubes rest and come no nearer to the rib after a failure."""
    case = usual_case()
    case = case._replace(controller=CONTROLLER.controller(ROBOT, case.lab.present, [RIB]))
    virtual = VirtualStation(case).moving(CIRCLE)
    virtual.lab.apply_load(PUSH, virtual.now)
    virtual.seconds(2.0)
    virtual.until(lambda: float(virtual.of("clearance")[-1, 0]) < 0.3e-3)
    before = true_clearance(virtual.lab, LIMITS)
    assert before < 0.6e-3

    FAILURES[failure](virtual)
    smallest = before
    for _ in range(50):
        virtual.seconds(0.02)
        smallest = min(smallest, true_clearance(virtual.lab, LIMITS))

    assert virtual.state in (State.STOPPED, State.HOLD, State.FAULT)
    assert virtual.rests()
    assert smallest > min(before - 0.2e-3, -0.1e-3)
