"""Joint, tube-order or workspace limit: refused before motion with value and bound; in the loop, braking included."""

import math
import re

import numpy as np
import pytest

from core.errors import CtrError, PoseError
from core.robot.limits import At
from station.config.motions import CircleMotion, JointSweepMotion, Orders, StepMotion
from station.config.robots import BoxFile, load_robot
from station.control.states import State
from station.control.task import Phase, Task
from station.devices.zaber.protocol import Command
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (CircleMotion(radius=0.08, period=60.0), r"circle.* (travel|speed) of \w+"),
        (StepMotion(offset=(0.0, 0.0, 0.2)), r"step.*"),
        (
            JointSweepMotion(joint="inner_translation", speed=0.01, distance=0.2),
            r"inner_translation 0.1 m is outside -0.13 ... -0.005 m \(its travel\)",
        ),
        (
            JointSweepMotion(joint="outer_rotation", speed=1.0, distance=0.2),
            r"speed 1 rad/s is outside \+-0.349066 rad/s",
        ),
    ],
)
def test_a_motion_that_cannot_be_made_is_refused_before_it_begins(case, motion, said) -> None:
    orders = Orders(motion, case.robot.robot())
    with pytest.raises(CtrError) as refusal:
        orders.check(case.controller, case.start, 60.0)
    assert re.search(said, str(refusal.value)), str(refusal.value)


def test_tube_order_and_workspace_are_refused_with_value_and_bound() -> None:
    robot = load_robot("three_tubes").model_copy(
        update={"workspace": BoxFile(lower=(-0.1, -0.1, 0.0), upper=(0.1, 0.1, 0.2))}
    )
    order, box = robot.limits().others
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
    out = middle.copy()
    slides = [i for i, joint in enumerate(robot.joints) if joint.motion == "translation"]
    out[slides[0]], out[slides[1]] = robot.joints[slides[0]].upper, robot.joints[slides[1]].lower
    nothing = np.zeros((3, len(robot.joints)))

    with pytest.raises(
        PoseError, match=r"tube order: end of tube 'middle' beyond that of tube 'outer' does not hold, by [\d.]+ mm"
    ):
        order.check(At(out, nothing, np.zeros(3), np.zeros(3)))
    with pytest.raises(PoseError, match=r"tip x 0.15 m is outside -0.1 ... 0.1 m \(the workspace\)"):
        box.check(At(middle, nothing, np.array([0.15, 0.0, 0.1]), np.zeros(3)))


def test_at_the_end_of_its_travel_an_axis_brakes_in_time(virtual: VirtualStation) -> None:
    virtual.ready()
    # the check before the motion is left out on purpose: the loop is the second layer
    sweep = JointSweepMotion(joint="inner_translation", speed=-0.02, distance=1.0)
    virtual.loop.start(Task(virtual.case.controller, Orders(sweep, virtual.case.robot.robot()), 6.0))
    virtual.until(lambda: virtual.loop.phase is Phase.MOVING)
    least, fastest = math.inf, 0.0
    while virtual.state is State.RUNNING:
        before = virtual.places[2]
        virtual.tick()
        least, fastest = min(least, virtual.places[2]), max(fastest, (before - virtual.places[2]) / 0.002)
    virtual.seconds(0.4)

    assert fastest == pytest.approx(0.02, rel=0.02)
    assert -0.130 <= least <= -0.129
    assert virtual.places[2] >= -0.130


def test_the_stages_own_maximum_positions_are_set_at_connect(virtual: VirtualStation) -> None:
    virtual.ready()
    maxima = [unit.settings[Command.SET_MAXIMUM] for unit in virtual.lab.chain.units]

    assert maxima[:2] == [3_072_000, 3_072_000]  # +-360 deg
    assert maxima[2] == pytest.approx(0.125 / 0.49609375e-6, abs=1.0)


def test_the_third_layer_an_axis_that_nobody_stops_ends_at_its_maximum_position(virtual: VirtualStation) -> None:
    virtual.moving(JointSweepMotion(joint="inner_translation", speed=-0.01, distance=0.025), since=0.5)
    virtual.fail("disconnect", "stages")
    virtual.seconds(6.0)

    assert virtual.places[2] == pytest.approx(-0.130, abs=1e-6)
