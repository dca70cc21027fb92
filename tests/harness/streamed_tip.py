"""A setpoint stream to a robot with regions in the virtual lab, and the largest error of its true tip."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from core.control.controller_settings import Controller
from core.control.setpoint_request import SetpointRequest
from core.robot.keep_out import KeepOut
from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamLimits, StreamRequest
from station.lab.config import load_lab
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import virtual_bench
from tests.harness.true_clearance import CONTROLLER, ROBOT, START, TICKS, true_clearance


class StreamRun(NamedTuple):
    """Result of a streamed run; distances from what was sent count from its convex hull."""

    state: State
    cause: str
    setpoint: float  #: largest distance of the setpoint from the hull of what was sent [m]
    tip: float  #: largest distance of the true tip from that hull [m]
    travelled: float  #: largest distance of the true tip from its start [m]
    clearance: float  #: smallest clearance of the true tubes from the true regions during the motion [m]
    at_start: float  #: the clearance at the start of the motion, which the errors of the model can make negative [m]


def distance_from_hull(point: Array, corners: Array) -> float:
    """Return the distance of a point (3,) from the convex hull of corners (k, 3) [m]."""
    weight = 1e3  # of the condition that the shares add up to 1
    rows = np.vstack((corners.T, np.full(len(corners), weight)))
    shares, _ = nnls(rows, np.append(point, weight))
    return float(np.linalg.norm(shares @ corners / shares.sum() - point))


def with_limits(limits: Sequence[KeepOut]) -> Controller:
    """Return the controller of the robot with these regions."""
    controller = CONTROLLER.controller(ROBOT, load_lab("gentle", ROBOT).present)
    return replace(controller, limits=replace(controller.limits, others=(*controller.limits.others, *limits)))


def stream(
    known: Sequence[KeepOut], true: Sequence[KeepOut], sent: Sequence[tuple[float, Array]], duration: float,
    seed: int = 0,
) -> StreamRun:  # fmt: skip
    """Stream setpoints for `duration` [s], as times [s] and positions (3,) relative to the start [m].

    The controller has the regions `known`; the clearance is that from the regions `true`.
    """
    lab = load_lab("gentle", ROBOT)
    bench, devices = virtual_bench(ROBOT, lab, seed, START)
    assert isinstance(bench, SimulatedBench)
    controller = with_limits(known)
    loop, tick, began = ControlLoop(controller, devices), 0, False
    corners, start = np.vstack((np.zeros(3), *(position for _, position in sent))), None
    setpoint = tip = travelled = 0.0
    clearance, at_start, since = np.inf, np.inf, 0.0
    loop.connect(0.0)
    while True:
        now = tick * PERIOD_S
        request = None
        if start is not None:
            newest = [position for time, position in sent if time <= now - since]
            request = StreamRequest(1, SetpointRequest(newest[-1], np.zeros(3), now, 0.0)) if newest else None
        truth = bench.advance(now)
        row = loop.tick(now, truth, request)
        if loop.state is State.READY and not began:
            loop.start(MotionTask(controller, StreamLimits(), duration))
            began = True
        elif (began and loop.progress is None) or loop.state in (State.HOLD, State.FAULT):
            return StreamRun(loop.state, loop.cause, setpoint, tip, travelled, clearance, at_start)
        elif loop.phase is Phase.MOVING and row is not None:
            if start is None:
                start, since = truth.tip.copy(), now
                origin = loop.channels.of(row, "tip_desired").copy()
            if tick % TICKS == 0:
                present = true_clearance(bench, true)
                clearance, at_start = min(clearance, present), present if np.isinf(at_start) else at_start
                moved = truth.tip - start
                tip = max(tip, distance_from_hull(moved, corners))
                travelled = max(travelled, float(np.linalg.norm(moved)))
                desired = loop.channels.of(row, "tip_desired") - origin
                setpoint = max(setpoint, distance_from_hull(desired, corners))
        tick += 1
