"""The control loop: at every tick poll the devices, take one step of the controller, send, report.

It holds the state, the tare and the progress of a run; the mathematics is `core.step`. It knows no
clock: whoever paces it says what time it is, real or virtual.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from core.errors import CtrError
from core.robot import Array
from core.step import Controller, Memory, Sample, Tick, begin, set_origin, step
from core.trajectories import JointMotion, Setpoint
from station.devices.interfaces import Devices, TipReading, Truth
from station.motions import Orders
from station.states import Event, State, after
from station.telemetry import Channels

#: At rest before a motion: the first part lets the filters settle, the rest is averaged for the
#: tare and for the start tip (60 tracker frames).
SETTLE = 0.5  # [s]
AVERAGE = 1.5  # [s]


class Phase(StrEnum):
    """What a run is doing."""

    SETTLING = "settling"
    MOVING = "moving"


@dataclass(frozen=True)
class Run:
    """A motion to carry out."""

    orders: Orders
    duration: float  #: of the motion, after the preparation [s]
    start: float  #: when the preparation began [s]

    @property
    def motion_start(self) -> float:
        """When the motion itself begins [s]."""
        return self.start + SETTLE + AVERAGE


class ControlLoop:
    """One bench under control."""

    def __init__(self, controller: Controller, devices: Devices) -> None:
        self.controller = controller
        self.state = State.OFF
        self.cause = ""  #: why the state is HOLD, STOPPED or FAULT
        self.run: Run | None = None
        self.phase: Phase | None = None
        self.channels = Channels(controller.statics.robot)
        self._devices = devices
        self._memory: Memory | None = None
        self._tare: Array | None = None
        self._wrenches: list[Array] = []
        self._tips: list[Array] = []

    def request(self, event: Event, cause: str = "") -> None:
        """Change the state.

        Raises:
            RefusedError: the present state does not allow it.
        """
        self.state = after(self.state, event)
        if event in (Event.STOP, Event.FAULT, Event.HOLD):
            self.cause, self.run, self.phase = cause, None, None
        elif event is Event.RESET:
            self.cause = ""

    def stop(self, now: float, event: Event = Event.STOP, cause: str = "stopped by the operator") -> None:
        """Stop every axis first, then change the state."""
        self._devices.stages.stop(now)
        self.request(event, cause)

    def start(self, orders: Orders, duration: float, now: float) -> Run:
        """Prepare at rest, then carry out a motion.

        Raises:
            RefusedError: not READY.
        """
        self.request(Event.START)
        self.run, self.phase = Run(orders, duration, now), Phase.SETTLING
        self._wrenches, self._tips = [], []
        return self.run

    def tick(self, now: float, truth: Truth | None = None) -> Array | None:
        """One period.

        Args:
            now: time of this tick [s].
            truth: what a virtual lab knows, for the record only.

        Returns:
            The row of `channels`; None until the first tracker frame has arrived.
        """
        stages = self._devices.stages
        joints = stages.poll(now)
        frame = self._devices.tracker.poll(now)
        wrenches = self._devices.sensors.poll(now)
        if self._tare is None:
            self._tare = wrenches.wrenches
        order = self._order(now, wrenches.wrenches, frame)
        sample = Sample(joints.positions, wrenches.wrenches - self._tare, None if frame is None else frame.position)
        if self._memory is None:
            if frame is None:
                return None
            self._memory = begin(self.controller, sample)
        try:
            tick: Tick = step(self.controller, self._memory, sample, order)
        except CtrError as error:
            # Nothing of this tick is sent but the stop; the next tick starts from the last good one.
            self.stop(now, Event.HOLD if self.state is State.RUNNING else Event.FAULT, str(error))
            return None
        self._memory = tick.memory
        if order is not None:
            stages.command(tick.command, now)
        return self.channels.row(now, self.state, joints, wrenches, frame, tick, truth)

    def _order(self, now: float, wrenches: Array, frame: TipReading | None) -> Setpoint | JointMotion | None:
        """What this tick has to do, and the progress of the run."""
        run = self.run
        if run is None:
            return None
        if now >= run.motion_start - 1e-9:
            if self.phase is Phase.SETTLING:
                self._finish_settling()
            if now - run.motion_start >= run.duration - 1e-9:
                self._devices.stages.stop(now)
                self.request(Event.FINISH)
                self.run, self.phase = None, None
                return None
            return run.orders.at(now - run.motion_start)
        if now >= run.start + SETTLE:
            self._wrenches.append(wrenches)
            if frame is not None:
                self._tips.append(frame.position)
        return None

    def _finish_settling(self) -> None:
        self._tare = np.mean(self._wrenches, axis=0)
        self._memory = set_origin(self._memory, np.mean(self._tips, axis=0)) if self._memory else None
        self.phase = Phase.MOVING
