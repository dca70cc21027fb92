"""The control loop: at every tick poll the devices, take one step of the controller, send, report.

It holds the state, the tare and the progress of a run; the mathematics is `core.step`. It knows no
clock: whoever paces it says what time it is, real or virtual.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from core.errors import CtrError
from core.robot import Array
from core.step import Controller, Memory, Sample, begin, set_origin, step
from core.trajectories import JointMotion, Setpoint
from station.devices.interfaces import Devices, JointReading, TipReading, Truth
from station.motions import Orders
from station.stall import Stall
from station.states import Event, State, after
from station.telemetry import Channels

#: At rest before a motion: the first part lets the filters settle, the rest is averaged for the
#: tare and for the start tip (60 tracker frames).
SETTLE = 0.5  # [s]
AVERAGE = 1.5  # [s]
#: The way to a start pose: at this part of the top speed, ending within a hundred microsteps.
APPROACH_SPEED = 0.5
APPROACH_RATE = 2.0  # [1/s]
APPROACH_TOLERANCE = 2e-3  # of a second at top speed


class Phase(IntEnum):
    """What a run is doing; the number is what telemetry carries."""

    NONE = 0
    APPROACHING = 1  #: the joints go to the start pose
    SETTLING = 2  #: at rest: tare, start tip
    MOVING = 3


@dataclass(frozen=True)
class Task:
    """A motion to carry out and how."""

    controller: Controller
    orders: Orders
    duration: float  #: of the motion, after the preparation [s]
    start: Array | None = None  #: joints (n,) to begin from; None: from where they are


@dataclass(frozen=True)
class Progress:
    """How far a task has come."""

    task: Task
    phase: Phase
    settle_start: float = 0.0  #: [s]

    @property
    def motion_start(self) -> float:
        """When the motion itself begins [s]; known from SETTLING on."""
        return self.settle_start + SETTLE + AVERAGE


class ControlLoop:
    """One bench under control."""

    def __init__(self, controller: Controller, devices: Devices) -> None:
        self.controller = controller
        self.state = State.OFF
        self.cause = ""  #: why the state is HOLD, STOPPED or FAULT
        self.progress: Progress | None = None  #: of the task that is on
        self.channels = Channels(controller.statics.robot)
        self._devices = devices
        self._memory: Memory | None = None
        self._tare: Array | None = None
        self._wrenches: list[Array] = []
        self._tips: list[Array] = []
        self._stall = Stall()

    @property
    def phase(self) -> Phase:
        """What the run is doing."""
        return self.progress.phase if self.progress else Phase.NONE

    def part_done(self, now: float) -> float:
        """Part of the motion that is done, 0 ... 1."""
        if self.progress is None or self.progress.phase is not Phase.MOVING:
            return 0.0
        return min(1.0, max(0.0, (now - self.progress.motion_start) / self.progress.task.duration))

    def request(self, event: Event, cause: str = "") -> None:
        """Change the state.

        Raises:
            RefusedError: the present state does not allow it.
        """
        self.state = after(self.state, event)
        if event in (Event.STOP, Event.FAULT, Event.HOLD):
            self.cause, self.progress = cause, None
        elif event is Event.RESET:
            self.cause = ""

    def stop(self, now: float, event: Event = Event.STOP, cause: str = "stopped by the operator") -> None:
        """Stop every axis first, then change the state."""
        self._devices.stages.stop(now)
        self.request(event, cause)

    def start(self, task: Task) -> None:
        """Go to the start pose, rest there for tare and start tip, then carry out the motion.

        Raises:
            RefusedError: not READY.
        """
        self.request(Event.START)
        self.controller = task.controller
        self.progress = Progress(task, Phase.APPROACHING)

    def tick(self, now: float, truth: Truth | None = None) -> Array | None:
        """One period.

        Args:
            now: time of this tick [s].
            truth: what a virtual lab knows, for the record only.

        Returns:
            The row of `channels`; None until the first tracker frame has arrived, and for a tick
            whose samples the controller could not use (the axes are then told to stop).
        """
        stages = self._devices.stages
        joints = stages.poll(now)
        frame = self._devices.tracker.poll(now)
        wrenches = self._devices.sensors.poll(now)
        if self._tare is None and np.isfinite(wrenches.wrenches).all():
            self._tare = wrenches.wrenches
        tare = wrenches.wrenches if self._tare is None else self._tare
        order = self._order(now, joints, wrenches.wrenches, frame)
        tip, age = (None, 0.0) if frame is None else (frame.position, now - frame.time)
        sample = Sample(joints.positions, joints.sent, wrenches.wrenches - tare, tip, age)
        try:
            if self._memory is None:
                if frame is None:
                    return None
                self._memory = begin(self.controller, sample)
            tick = step(self.controller, self._memory, sample, order)
        except CtrError as error:
            # Nothing of this tick is sent but the stop; the next tick goes on from the last good one.
            stages.stop(now)
            if self.state in (State.READY, State.RUNNING):
                self.request(Event.HOLD, str(error))
            return None
        self._memory = tick.memory
        if isinstance(order, Setpoint) and frame is not None:
            stalled = self._stall.look(now, tick, self.controller.limits)
            if stalled:
                stages.stop(now)
                self.request(Event.HOLD, stalled)
                return self.channels.row(now, self.state, joints, wrenches, frame, tick, truth)
        if order is not None:
            stages.command(tick.command, now)
        return self.channels.row(now, self.state, joints, wrenches, frame, tick, truth)

    def _order(
        self, now: float, joints: JointReading, wrenches: Array, frame: TipReading | None
    ) -> Setpoint | JointMotion | None:
        """What this tick has to do, and the progress of the run."""
        progress = self.progress
        if progress is None:
            return None
        task = progress.task
        if progress.phase is Phase.APPROACHING:
            velocity = self._approach(joints.positions, task.start)
            if velocity is not None:
                return JointMotion(velocity)
            self._devices.stages.stop(now)
            self._wrenches, self._tips = [], []
            self.progress = replace(progress, phase=Phase.SETTLING, settle_start=now)
            return None
        if now < progress.motion_start - 1e-9:
            if now >= progress.settle_start + SETTLE:
                self._wrenches.append(wrenches)
                if frame is not None:
                    self._tips.append(frame.position)
            return None
        if progress.phase is Phase.SETTLING:
            if not self._tips or self._memory is None:
                self._devices.stages.stop(now)
                self.request(Event.HOLD, f"no tracker frame in {AVERAGE:g} s; is the coil inside the tracker's volume?")
                return None
            self._tare = np.mean(self._wrenches, axis=0)
            self._memory = set_origin(self.controller, self._memory, np.mean(self._tips, axis=0))
            self._stall = Stall()
            self.progress = replace(progress, phase=Phase.MOVING)
        if now - progress.motion_start >= task.duration - 1e-9:
            self._devices.stages.stop(now)
            self.request(Event.FINISH)
            self.progress = None
            return None
        return task.orders.at(now - progress.motion_start)

    def _approach(self, joints: Array, start: Array | None) -> Array | None:
        """Velocities (n,) toward the start pose, all joints arriving together; None when there."""
        if start is None:
            return None
        speed = self.controller.limits.speed
        way = (start - joints) / speed
        if np.abs(way).max() <= APPROACH_TOLERANCE:
            return None
        return way * min(APPROACH_RATE, APPROACH_SPEED / np.abs(way).max()) * speed
