"""Rehearsal of the controller: compute ticks with all features of motions before the control loop runs.

A function is compiled, or loaded from the cache, at its first call with arguments of certain types. In a tick of a
running loop this would take from 10 ms to minutes. The rehearsal therefore calls every function of a tick. One
controller has all features of the built-in loops; further controllers have the features that exclude these.

`tests/harness/every_feature.py` runs each feature by itself. A test fails if a feature needs a function that was not
rehearsed.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from core.control.controller_settings import Controller
from core.control.controllers import INNER_LOOPS, LoopInputs, PositionMode, Strategy, type_2
from core.control.estimation import NO_LOAD
from core.control.force_control import Press
from core.control.null_space import OBJECTIVES, NullSpaceObjective
from core.control.sensors import Corrections, Sensors
from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, DEFAULT_TURN_BOUNDS, SetpointRequest, StreamedTip
from core.control.step import ControllerState, Sample, restart_setpoints_here, set_origin, start_controller, step
from core.control.stiffness import TipStiffness
from core.control.tip_direction import TASKS, TaskSelection, task_selection
from core.control.tip_force import LoadEstimator
from core.control.trajectories import JointMotion, Setpoint
from core.control.velocity_ik import VelocityTask
from core.model.fold import margin_of_worst_tubes
from core.robot.keep_out import KeepOut
from core.robot.regions import Region
from core.robot.robot import Array

#: Number of rehearsed ticks of each motion: some functions use the results of the tick before, so one is too few.
TICKS = 2
_NO_STEP = np.zeros(3)
_UP = np.array([0.0, 0.0, 1.0])


def rehearse(controller: Controller, joints: Array, *, all_features: bool) -> None:
    """Call the compiled functions of ticks, in the pose `joints` (n,) [rad or m].

    Args:
        controller: controller whose robot and limits the rehearsal uses.
        joints: joint positions (n,) [rad or m].
        all_features: whether to call the functions of all motions and controllers, or those of this controller only.

    Raises:
        CtrError: the model has no shape in this pose.
    """
    robot = controller.statics.robot
    free = controller.statics.solve(joints, NO_LOAD)
    margin_of_worst_tubes(controller.statics, free, joints, 0.05)
    wrenches = np.zeros((len(robot.sensor_names), 6))
    # The joints move at top speed, so that their acceleration must be limited.
    sample = Sample(joints, controller.limits.speed, wrenches, free.tip.copy(), 0.0, free.rotation[:, 2].copy())
    gains = PositionMode(1.0, 1.0, feedforward=True)
    plain = replace(
        controller,
        strategy=Strategy(gains, type_2),
        estimator=replace(controller.estimator, load=LoadEstimator(True, adapts=True, tracks_zeros=True)),
        aim=TaskSelection(), observes=True, tracked=True, senses=True, differentiates=False, stiffness=None, tasks=(),
    )  # fmt: skip
    if not all_features:
        memory = start_controller(controller, sample)
        _run(controller, memory, sample)
        _run(replace(controller, watches=True), memory, sample)  # a calibration needs the tip's direction
        return
    memory = start_controller(plain, sample)
    # The tip is at the surface of this region, so the tip must retreat. A monitor of the loop calls `distance`.
    region = Region("rehearsal", "half_space", (*free.tip.tolist(), 0.0, 0.0, 1.0))
    region.distance(free.tip)
    for one in _variants(plain, region):
        _run(one, memory, sample)
    stream = StreamedTip(DEFAULT_MOTION_BOUNDS, DEFAULT_TURN_BOUNDS, _UP)
    for request in (None, SetpointRequest(_NO_STEP, _NO_STEP, 0.0, 0.0, _UP)):
        stream.advance(0.0, request, controller.period)


def _variants(plain: Controller, region: Region) -> Iterator[Controller]:
    """Yield controllers that together use every function of a tick, some of them near a region."""
    robot, joints, limits = plain.statics.robot, len(plain.limits.joints), plain.limits
    near = replace(limits, others=(*limits.others, KeepOut(region)))
    sensors = replace(Sensors.ideal(robot), skew=np.zeros((len(robot.sensor_names), 6, 6)))
    everything = replace(
        plain,
        limits=near,
        corrections=Corrections(sensors, np.zeros(3), _UP),
        null_space=NullSpaceObjective(dict.fromkeys(OBJECTIVES, 1.0)),
        stiffness=TipStiffness((1e3, 1e3, 1e3)),
    )
    for aim in map(task_selection, TASKS):
        if aim.rows <= joints:
            yield replace(everything, aim=aim)
    yield replace(plain, differentiates=True)
    # A learned residual is used with a tracker only.
    yield replace(plain, tracked=False, watches=True, estimator=replace(plain.estimator, residual=None))
    yield replace(plain, senses=False)
    for inner in INNER_LOOPS.values():
        yield replace(plain, limits=near, strategy=Strategy(_CustomOuter(), inner))
    yield replace(plain, strategy=Strategy(PositionMode(1.0, 1.0), _custom_inner))


class _CustomOuter:
    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Return the velocity of a built-in loop."""
        return PositionMode(1.0, 1.0).tip_velocity(setpoint, tip)


def _custom_inner(u_int: Array, view: LoopInputs) -> VelocityTask:
    return type_2(u_int, view)


def _run(controller: Controller, memory: ControllerState, sample: Sample) -> None:
    """Compute ticks with each kind of order; `memory` is the state of another controller of the robot."""
    here = np.zeros(3)
    orders: list[Setpoint | JointMotion | None] = [
        Setpoint(here, here), Setpoint(here, here, _UP, here), JointMotion(controller.limits.speed), None,
    ]  # fmt: skip
    if controller.stiffness is None and controller.strategy.gain > 0.0:
        orders.append(Setpoint(here, here, press=Press(_UP, 0.1, 0.005, 0.01)))
    if not controller.tracked:
        sample, memory = sample._replace(tip=None, direction=None), memory._replace(deflection=None)
    for order in orders:
        for _ in range(TICKS):
            memory = step(controller, memory, sample, order).memory
    controller.tare(sample.wrenches, sample.joints)
    controller.tip(memory.tip, memory.estimate.loaded.rotation)
    restarted = restart_setpoints_here(set_origin(controller, memory, memory.tip))
    step(controller, restarted, sample, orders[1])
