"""A control loop on ideal devices in virtual time, with the true force on the tip at every tick."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from core.control.controller_settings import Controller
from core.control.setpoint_request import SetpointRequest
from core.control.trajectories import JointMotion
from core.robot.limits import ForceBound
from core.robot.robot import Array
from station.config.controllers import PERIOD_S, Present, default_controller
from station.config.motions import ForceMotion, HoldMotion, Orders, suited
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import JogSpace, MotionTask, Phase, StreamLimits, StreamRequest
from station.lab.config import load_lab
from station.lab.virtual_bench import virtual_bench
from tests.harness.virtual_station import usual_case

Kind = Literal["tracker", "sensors"]
#: Kinds of benches that know a force, by the devices that they lack.
BENCHES: tuple[tuple[Kind, ...], ...] = ((), ("tracker",), ("sensors",))


class AtRest:
    """Orders of a `goto`: the joints rest at the end of the approach."""

    def at(self, time: float) -> JointMotion:
        return JointMotion(np.zeros(3))


class IdealStation:
    """A control loop on a bench without noise and delay that lacks the given devices; the test ticks it."""

    def __init__(self, without: Sequence[Kind] = (), bound: float | None = None) -> None:
        """Create a station that is READY; `bound` replaces the largest force of tubes and sensors [N]."""
        self._overload = None if bound is None else ForceBound(bound, "the bound of this test")
        self.case = usual_case()
        self.present = Present("tracker" not in without, "sensors" not in without)
        lab = load_lab("ideal", self.case.robot).leaving_out(without)
        self.file = default_controller(self.present)
        self.controller = self._bounded(self.file.controller(self.case.robot, self.present))
        self.lab, devices = virtual_bench(self.case.robot, lab, 0, self.case.start)
        self.loop = ControlLoop(self.controller, devices)
        self.now = -PERIOD_S
        self.true: list[Array] = []  #: true force on the tip (3,) at each tick [N]
        self.joints: list[Array] = []  #: joints (3,) at each tick [rad or m]
        self.request: Callable[[float], StreamRequest | None] = lambda _: None
        self.loop.connect(0.0)
        self.until(lambda: self.state is State.READY)
        self.seconds(2.0)

    def _bounded(self, controller: Controller) -> Controller:
        if self._overload is None:
            return controller
        return replace(controller, limits=replace(controller.limits, overload=self._overload))

    @property
    def state(self) -> State:
        return self.loop.state

    @property
    def bound(self) -> float:
        assert self.controller.limits.overload is not None
        return self.controller.limits.overload.newton

    @property
    def true_size(self) -> float:
        return float(np.linalg.norm(self.true[-1]))

    @property
    def known_size(self) -> float:
        """Force that the loop compares with its bound [N]."""
        force = self.loop.total_force
        assert force is not None
        return float(np.linalg.norm(force))

    @property
    def peak(self) -> float:
        """Largest true force [N]."""
        return float(np.linalg.norm(self.true, axis=1).max())

    def tick(self) -> None:
        self.now = round(self.now + PERIOD_S, 9)
        truth = self.lab.advance(self.now)
        self.loop.tick(self.now, truth, self.request(self.now))
        self.true.append(truth.force.copy())
        self.joints.append(self.lab.devices.stages.poll(self.now).positions)  # type: ignore[union-attr]

    def seconds(self, time: float) -> None:
        for _ in range(round(time / PERIOD_S)):
            self.tick()

    def until(self, holds: Callable[[], bool], most: float = 60.0) -> None:
        begin = self.now
        while not holds():
            assert self.now - begin < most, (self.state, self.loop.cause, self.loop.phase)
            self.tick()

    def end(self) -> None:
        """Tick until the motion ends."""
        self.until(lambda: self.state is not State.RUNNING)

    def pressing(self, direction: Sequence[float], force: float, duration: float, **more: float) -> MotionTask:
        motion = ForceMotion.model_validate({"direction": tuple(direction), "force": force, **more})
        controller = self._bounded(suited(self.file, motion).controller(self.case.robot, self.present))
        return MotionTask(controller, Orders(motion, self.case.robot.robot()), duration)

    def holding(self, duration: float, start: Array | None = None) -> MotionTask:
        return MotionTask(self.controller, Orders(HoldMotion(), self.case.robot.robot()), duration, start)

    def going(self, joints: Array) -> MotionTask:
        return MotionTask(self.controller, AtRest(), 0.0, joints, rests=False)

    def stream(self, goal: Array, duration: float) -> None:
        """Start a streamed motion to `goal` (3,) relative to its start [m]."""
        self.loop.start(MotionTask(self.controller, StreamLimits(), duration))
        self.until(lambda: self.loop.phase is Phase.MOVING or self.state is not State.RUNNING)
        self.request = lambda now: StreamRequest(1, SetpointRequest(goal, np.zeros(3), now, 0.1))

    def jog(self, space: JogSpace, velocity: Sequence[float], seconds: float) -> None:
        """Jog until the time is over or the jog ends in HOLD."""
        for _ in range(round(seconds / 0.1)):
            if self.state not in (State.READY, State.RUNNING):
                return
            self.loop.jog(self.now, space, np.array(velocity))
            self.seconds(0.1)
        self.end()
