"""The loaded tubes of the simulated robot keep their distance from regions during motions."""

import numpy as np
import pytest

from core.errors import CtrError, Unreachable
from core.robot.keep_out import KeepOut
from core.robot.robot import Array
from station.camera.rendering import centre_points
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.loads import RampLoad
from station.config.motions import CircleMotion, Orders
from station.config.regions import CapsuleRegion, RegionFile, SphereRegion
from station.config.robots import load_robot
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.lab.config import load_lab
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import virtual_bench

START = np.array([0.0, 0.5 * np.pi, -0.1])
CONTROLLER = ControllerFile(inner="type_2", feedback="observer", feedforward=True, load="wrenches")
#: A rib that the circle below would touch without the limit.
RIB = CapsuleRegion(name="rib", start=(0.0144, -0.04, 0.1285), end=(0.0144, 0.01, 0.1285), radius=0.004)
CIRCLE = CircleMotion(radius=0.006, period=12.0)
ROBOT = load_robot("paper")


def true_clearance(bench: SimulatedBench, limit: KeepOut) -> float:
    """Return the smallest clearance of the true tubes, whose centre line is sampled every half millimetre [m]."""
    shape = bench.shape()
    arc = np.linspace(0.0, shape.ends.max(), 400)
    radii: Array = np.zeros(400)
    for end, tube in zip(shape.ends, ROBOT.robot().tubes, strict=True):
        radii = np.where(arc <= end + 1e-9, np.maximum(radii, 0.5 * tube.outer_diameter), radii)
    region = limit.region
    sign = -1.0 if region.inside else 1.0
    return min(
        sign * region.distance(point)[0] - radius - region.margin
        for point, radius in zip(centre_points(shape.line, arc), radii, strict=True)
    )


def smallest_clearance(region: RegionFile, *, limited: bool, lab: str = "gentle") -> float:
    """Run the circle under a load toward the region; return the smallest true clearance [m]."""
    config = load_lab(lab, ROBOT)
    controller = CONTROLLER.controller(ROBOT, config.present, [region] if limited else [])
    (limit,) = (one for one in CONTROLLER.controller(ROBOT, config.present, [region]).limits.others
                if isinstance(one, KeepOut))  # fmt: skip
    bench, devices = virtual_bench(ROBOT, config, 0, START)
    assert isinstance(bench, SimulatedBench)
    loop, found, tick, loaded = ControlLoop(controller, devices), np.inf, 0, False
    loop.connect(0.0)
    while True:
        loop.tick(tick * PERIOD_S, bench.advance(tick * PERIOD_S))
        if loop.state is State.READY and loop.progress is None and not loaded:
            loop.start(MotionTask(controller, Orders(CIRCLE, controller.statics.robot), 12.0, START))
        elif loop.progress is None and loaded:
            return found
        elif loop.phase is Phase.SETTLING and loop.progress is not None and not loaded:
            bench.apply_load(RampLoad(times=(0.0, 6.0), magnitudes=(0.0, 0.1)), loop.progress.motion_start)
            loaded = True
        elif loop.phase is Phase.MOVING and tick % 10 == 0:
            found = min(found, true_clearance(bench, limit))
        tick += 1


def test_the_true_tubes_keep_the_margin_of_a_rib_that_the_path_would_touch() -> None:
    """Errors of the uncalibrated model, which the limit does not know, are up to a quarter of the margin."""
    assert smallest_clearance(RIB, limited=False) < -0.6e-3
    assert smallest_clearance(RIB, limited=True) > -0.25e-3


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
