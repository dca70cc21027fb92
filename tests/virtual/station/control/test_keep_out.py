"""The loaded tubes of the simulated robot keep their distance from regions during motions."""

import numpy as np
import pytest

from core.errors import CtrError, Unreachable
from station.config.loads import RampLoad
from station.config.motions import CircleMotion, Orders, WaypointsMotion
from station.config.regions import BoxRegion, CapsuleRegion, SphereRegion
from tests.harness.true_clearance import CONTROLLER, ROBOT, START, run_between

#: A rib that the circle below would touch without the limit, under a load toward it.
RIB = CapsuleRegion(name="rib", start=(0.0144, -0.04, 0.1285), end=(0.0144, 0.01, 0.1285), radius=0.004)
CIRCLE = CircleMotion(radius=0.006, period=12.0)
PUSH = RampLoad(times=(0.0, 6.0), magnitudes=(0.0, 0.1))


def test_the_true_tubes_keep_the_margin_of_a_rib_that_the_path_would_touch() -> None:
    """Errors of the uncalibrated model, which the limit does not know, are up to a quarter of the margin."""
    limited = run_between([RIB], CIRCLE, 7.0, PUSH)

    assert -0.25e-3 < limited.true < 0.3e-3  # without the limit it is less than -0.6 mm
    assert limited.recorded == pytest.approx(limited.true, abs=0.25e-3)
    assert limited.recorded > -0.1e-3


def test_the_true_tubes_keep_the_margin_in_a_corner_that_the_path_cuts() -> None:
    """The path leaves a box through a wall and passes its edge outside for more than five seconds."""
    x, y, _ = CONTROLLER.controller(ROBOT).statics.solve(START, np.zeros(6)).tip
    lower, upper = np.array([-0.1, y - 0.006, -0.05]), np.array([x + 0.006, 0.1, 0.35])
    box = BoxRegion(
        name="box", centre=tuple((0.5 * (lower + upper)).tolist()), edges=tuple((upper - lower).tolist()), inside=True
    )
    motion = WaypointsMotion(
        points=((0.0, 0.0, 0.0, 0.0), (3.0, 0.010, -0.002, 0.0), (6.0, 0.002, -0.010, 0.0), (9.0, 0.0, 0.0, 0.0))
    )
    found = run_between([box], motion, 9.0, PUSH)

    assert -0.1e-3 < found.true < 0.3e-3  # the tubes stop 0.25 mm before the margin
    assert found.cause.startswith("the path leads through the region 'box'")


def test_a_motion_through_a_region_is_refused_with_its_name() -> None:
    tip = CONTROLLER.controller(ROBOT).statics.solve(START, np.zeros(6)).tip
    ball = SphereRegion(name="ball", centre=(tip[0], tip[1] + 0.012, tip[2]), radius=0.004)
    controller = CONTROLLER.controller(ROBOT, regions=[ball])
    with pytest.raises(Unreachable, match="region 'ball'"):
        Orders(CIRCLE, controller.statics.robot).check(controller, START, 12.0)


def test_a_start_pose_inside_a_region_is_refused() -> None:
    tip = CONTROLLER.controller(ROBOT).statics.solve(START, np.zeros(6)).tip
    ball = SphereRegion(name="ball", centre=tuple(tip.tolist()), radius=0.004)
    controller = CONTROLLER.controller(ROBOT, regions=[ball])
    with pytest.raises(CtrError, match="the region 'ball' near"):
        Orders(CIRCLE, controller.statics.robot).check(controller, START, 12.0)
