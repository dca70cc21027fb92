"""A run in the virtual lab, and the clearance of its true tubes from regions."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.control.controller_settings import Controller
from core.control.velocity_ik import inverse_at
from core.model.backbone import backbone
from core.model.solution import pure_force
from core.robot.keep_out import KeepOut
from core.robot.robot import Array
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.loads import Load
from station.config.motions import Motion, Orders
from station.config.regions import RegionFile, keep_out
from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.control.telemetry import Channels
from station.lab.config import load_lab
from station.lab.rendering import centre_points
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import virtual_bench

START = np.array([0.0, 0.5 * np.pi, -0.1])
CONTROLLER = ControllerFile(inner="type_2", feedback="observer", feedforward=True, load="wrenches")
ROBOT = load_robot("paper")
#: Number of points along the true tubes, and number of ticks between two evaluations.
POINTS, TICKS = 400, 10
#: Number, length [m] and duration [s] of the steps from the last pose to the setpoint.
STEPS, STEP_M, STEP_S = 100, 5e-4, 0.1


class ClearanceRun(NamedTuple):
    """Result of a run."""

    true: float  #: smallest clearance of the true tubes during the motion [m]
    recorded: float  #: smallest recorded clearance [m]
    cause: str  #: why the motion ended early; empty if it did not
    #: smallest clearance of the model's tubes with the tip at the last setpoint; inf if the motion was complete
    at_setpoint: float = np.inf


def true_clearance(bench: SimulatedBench, limits: Sequence[KeepOut]) -> float:
    """Return the present smallest clearance of the true tubes [m]."""
    shape = bench.shape()
    arc = np.linspace(0.0, shape.ends.max(), POINTS)
    radii: Array = np.zeros(POINTS)
    for end, tube in zip(shape.ends, ROBOT.robot().tubes, strict=True):
        radii = np.where(arc <= end + 1e-9, np.maximum(radii, 0.5 * tube.outer_diameter), radii)
    points = centre_points(shape.line, arc)
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    smallest, largest_radius = np.inf, float(radii.max())
    for limit in limits:
        side = -1.0 if limit.region.inside else 1.0
        i = 0
        while i < POINTS:
            distance = side * limit.region.distance(points[i])[0] - limit.region.margin
            smallest = min(smallest, distance - radii[i])
            # The distance changes at most as much as the point moves, so nearer points are at least this far along.
            ahead = travelled[i] + max(distance - largest_radius - smallest, 0.0)
            i = max(i + 1, int(np.searchsorted(travelled, ahead)))
    return float(smallest)


def clearance_at_setpoint(controller: Controller, channels: Channels, row: Array) -> float:
    """Return the smallest clearance of the model's tubes whose tip is at the setpoint of a recorded row [m].

    The tip moves there in small steps from its pose, without regard to regions.
    """
    joints, force, desired, observed = (
        channels.of(row, name).copy() for name in ("joints", "force_estimated", "tip_desired", "tip_observed")
    )
    at = controller.statics.solve(joints, pure_force(force))
    offset = observed - at.tip
    for _ in range(STEPS):
        left = desired - offset - at.tip
        step = left * min(1.0, STEP_M / max(float(np.linalg.norm(left)), 1e-12))
        joints = joints + inverse_at(controller.limits, joints, at.jacobian[:3], step / STEP_S).velocity * STEP_S
        at = controller.statics.solve(joints, pure_force(force), at)
    near = backbone(controller.statics, at, at.tip + offset)
    return min(region.clearance(near).distance for region in controller.regions)


def run_between(
    regions: Sequence[RegionFile], motion: Motion, duration: float, load: Load, *, limited: bool = True,
    lab: str = "gentle", seed: int = 0, calibration: BenchCalibration | None = None,
) -> ClearanceRun:  # fmt: skip
    """Run a motion under a load in the virtual lab; `limited`: whether the controller knows the regions."""
    config, known, registration = load_lab(lab, ROBOT), ROBOT, None
    if calibration is not None:
        known, registration = calibration.robot, calibration.registration
    controller = CONTROLLER.controller(known, config.present, regions if limited else [])
    if calibration is not None:
        controller = calibration.applied(controller)
    limits, (bench, devices) = keep_out(regions), virtual_bench(ROBOT, config, seed, START, registration)
    assert isinstance(bench, SimulatedBench)
    loop, true, recorded, tick, loaded = ControlLoop(controller, devices), np.inf, np.inf, 0, False
    last = np.empty(0)
    loop.connect(0.0)
    while True:
        row = loop.tick(tick * PERIOD_S, bench.advance(tick * PERIOD_S))
        if loop.state is State.READY and loop.progress is None and not loaded:
            loop.start(MotionTask(controller, Orders(motion, controller.statics.robot), duration, START))
        elif loop.progress is None and loaded:
            stopped = loop.cause and controller.regions
            at_setpoint = clearance_at_setpoint(controller, loop.channels, last) if stopped else np.inf
            return ClearanceRun(true, recorded, loop.cause, at_setpoint)
        elif loop.phase is Phase.SETTLING and loop.progress is not None and not loaded:
            bench.apply_load(load, loop.progress.motion_start)
            loaded = True
        elif loop.phase is Phase.MOVING and tick % TICKS == 0 and row is not None:
            last = row
            true = min(true, true_clearance(bench, limits))
            recorded = min(recorded, float(loop.channels.of(row, "clearance")[0]))
        tick += 1
