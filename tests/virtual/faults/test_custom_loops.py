"""A custom loop that raises an error or returns a wrong value is refused before the motion or causes HOLD.

The error and the cause name the loop.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from core.control.controllers import PositionMode, Strategy, type_2
from core.errors import ContractError
from core.robot.robot import Array
from station.config.motions import Orders
from station.control.states import State
from station.control.task import MotionTask, Phase
from tests.harness.virtual_station import CIRCLE, VirtualStation

GAINS = PositionMode(2.5, 2.5)


@dataclass
class LaterWrong:
    """Outer loop that returns valid velocities until the test sets `right` to False."""

    wrong: Callable[[Array], Any]
    right: bool = True

    def tip_velocity(self, setpoint: Any, tip: Array) -> Any:
        u_int = GAINS.tip_velocity(setpoint, tip)
        return u_int if self.right else self.wrong(u_int)


def raises(u_int: Array) -> Any:
    raise KeyError("gain")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda u: u[:, None], "U_int has shape (3, 1)"),
        (lambda u: u * np.nan, "U_int is [nan, nan, nan]"),
        (raises, "raised KeyError: 'gain'"),
    ],
)
def test_custom_loop_that_fails_during_a_run_causes_hold_and_is_named(
    virtual: VirtualStation, wrong: Callable[[Array], Any], said: str
) -> None:
    virtual.ready()
    loop = LaterWrong(wrong)
    controller = replace(virtual.case.controller, strategy=Strategy(loop, type_2))
    virtual.loop.start(MotionTask(controller, Orders(CIRCLE, virtual.case.robot.robot()), 60.0))
    virtual.until(lambda: virtual.loop.phase is Phase.MOVING)
    virtual.seconds(0.5)
    loop.right = False
    virtual.tick()

    assert virtual.state is State.HOLD
    assert "outer loop 'LaterWrong'" in virtual.loop.cause
    assert said in virtual.loop.cause
    virtual.seconds(0.4)
    assert virtual.rests()


@pytest.mark.parametrize(
    "strategy",
    [
        Strategy(LaterWrong(lambda u: 0.01, right=False), type_2),
        Strategy(GAINS, lambda u, view: (view.loaded.jacobian[:3], 0.01)),
        Strategy(GAINS, lambda u, view: (view.loaded.jacobian, u)),
        Strategy(LaterWrong(raises, right=False), type_2),
    ],
)
def test_custom_loop_with_a_wrong_result_is_refused_before_the_motion(
    virtual: VirtualStation, strategy: Strategy
) -> None:
    controller = replace(virtual.case.controller, strategy=strategy)
    with pytest.raises(ContractError, match=r"outer loop 'LaterWrong'|inner loop '<lambda>'"):
        Orders(CIRCLE, virtual.case.robot.robot()).check(controller, virtual.case.start, 8.0)
