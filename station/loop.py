"""The control loop: at every tick poll the devices, take one step of the controller, send, report.

It holds the state, the tare and the progress of a run; the mathematics is `core.step`. It knows no
clock: whoever paces it says what time it is, real or virtual.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import numpy as np

from core.errors import CtrError
from core.robot import Array
from core.step import Controller, Memory, Sample, begin, set_origin, step
from core.trajectories import JointMotion, Setpoint
from station.devices.interfaces import (
    Condition,
    Devices,
    JointReading,
    Severity,
    TipReading,
    Trouble,
    Truth,
    WrenchReading,
)
from station.jog import Jog
from station.motions import Orders
from station.stall import Stall
from station.states import Event, RefusedError, State, after
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
    JOGGING = 4  #: moved by hand


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
        self.devices = devices
        self.state = State.OFF
        self.cause = ""  #: why the state is HOLD, STOPPED or FAULT
        self.progress: Progress | None = None  #: of the task that is on
        self.channels = Channels(controller.statics.robot)
        self._memory: Memory | None = None
        self._row: Array | None = None
        self._troubles: tuple[int, ...] = (0, 0, 0)  # severities: stages, tracker, sensors
        self._jog: Jog | None = None
        self._tare: Array | None = None
        self._taring_since: float | None = None
        self._wrenches: list[Array] = []
        self._tips: list[Array] = []
        self._stall = Stall()

    @property
    def phase(self) -> Phase:
        """What the run is doing."""
        if self._jog is not None:
            return Phase.JOGGING
        return self.progress.phase if self.progress else Phase.NONE

    def part_done(self, now: float) -> float:
        """Part of the motion that is done, 0 ... 1."""
        if self.progress is None or self.progress.phase is not Phase.MOVING:
            return 0.0
        return min(1.0, max(0.0, (now - self.progress.motion_start) / self.progress.task.duration))

    # What may be asked of it

    def request(self, event: Event, cause: str = "") -> None:
        """Change the state.

        Raises:
            RefusedError: the present state does not allow it.
        """
        self.state = after(self.state, event)
        if event in (Event.STOP, Event.FAULT, Event.HOLD):
            self.cause, self.progress, self._jog, self._taring_since = cause, None, None, None
        elif event in (Event.RESET, Event.CONNECT):
            self.cause = ""

    def connect(self, now: float) -> None:
        """Find every device and set it up; a reset after a fault does the same.

        Raises:
            RefusedError: not OFF.
        """
        self.request(Event.CONNECT)
        self._connect(now)

    def reset(self, now: float) -> None:
        """A person has seen the hold, the stop or the fault.

        Raises:
            RefusedError: there is nothing to reset.
        """
        self.request(Event.RESET)
        if self.state is State.CONNECTING:
            self._connect(now)
            return
        for device in (self.devices.tracker, self.devices.sensors):
            if device.trouble(now) is not None:
                device.connect(now)

    def home(self, now: float) -> None:
        """Home every stage; a person has said that the way is clear.

        Raises:
            RefusedError: neither CONNECTED nor READY.
            CtrError: the stages cannot.
        """
        after(self.state, Event.HOME)
        self.devices.stages.home(now)
        self.request(Event.HOME)

    def stop(self, now: float, event: Event = Event.STOP, cause: str = "stopped by the operator") -> None:
        """Stop every axis first, then change the state."""
        self.devices.stages.stop(now)
        self.request(event, cause)

    def start(self, task: Task) -> None:
        """Go to the start pose, rest there for tare and start tip, then carry out the motion.

        Raises:
            RefusedError: not READY.
        """
        self.request(Event.START)
        self.controller = task.controller
        self.progress = Progress(task, Phase.APPROACHING)

    def tare(self, now: float) -> None:
        """Take what the force sensors feel in the next moments as zero.

        Raises:
            RefusedError: not READY, so perhaps not at rest.
        """
        if self.state is not State.READY:
            raise RefusedError(f"'tare' is not possible while {self.state.name}; it needs READY")
        self._taring_since, self._wrenches = now, []

    def jog(self, now: float, space: Literal["joints", "tip"], velocity: Array) -> None:
        """Move by hand, or go on with it: ends by itself when this is not called again soon.

        Args:
            now: time [s].
            space: what `velocity` is of.
            velocity: (n,) [rad/s or m/s] of the joints or (3,) [m/s] of the tip.

        Raises:
            RefusedError: not READY.
        """
        if self._jog is not None and self._jog.renew(space, velocity, now):
            return
        self.request(Event.START)
        self._jog = Jog.begin(space, velocity, now)
        if self._memory is not None:
            self._memory = self._memory._replace(origin=self._memory.estimate.observed.tip)
        self._stall = Stall()

    # A period

    def tick(self, now: float, truth: Truth | None = None) -> Array | None:
        """One period.

        Args:
            now: time of this tick [s].
            truth: what a virtual lab knows, for the record only.

        Returns:
            The row of `channels`: while positions are not known, or in a tick whose samples the
            controller could not use (the axes are then told to stop), with the last estimates standing.
            None until the controller has begun.
        """
        devices, stages = self.devices, self.devices.stages
        if self.state is State.OFF and stages.condition is Condition.CLOSED:
            return None
        joints = stages.poll(now)
        frame = devices.tracker.poll(now)
        wrenches = devices.sensors.poll(now)
        trouble = self._look(now)
        self._go_on(stages.condition)
        if not stages.ready:
            self._memory = None
            return self._held(now, joints, wrenches)
        if self._tare is None and wrenches.usable:
            self._tare = self.controller.tare(wrenches.wrenches, joints.positions)
        tare = wrenches.wrenches if self._tare is None else self._tare
        order = None if trouble else self._order(now, joints, wrenches.wrenches, frame)
        tip, age = (None, 0.0) if frame is None else (frame.position, now - frame.time)
        sample = Sample(joints.positions, joints.sent, wrenches.wrenches - tare, tip, age)
        try:
            if self._memory is None:
                if frame is None or not wrenches.usable:
                    return self._held(now, joints, wrenches)
                self._memory = begin(self.controller, sample)
            tick = step(self.controller, self._memory, sample, order)
        except CtrError as error:
            # Nothing of this tick is sent but the stop; the next tick goes on from the last good one.
            stages.stop(now)
            if self.state in (State.READY, State.RUNNING):
                self.request(Event.HOLD, str(error))
            return self._held(now, joints, wrenches)
        self._memory = tick.memory
        if isinstance(order, Setpoint) and frame is not None:
            stalled = self._stall.look(now, tick, self.controller.limits)
            if stalled:
                stages.stop(now)
                self.request(Event.HOLD, stalled)
                order = None
        if order is not None:
            stages.command(tick.command, now)
        self._row = self.channels.row(now, self.state, joints, wrenches, frame, tick, truth, self._troubles)
        return self._row

    def _connect(self, now: float) -> None:
        self._memory, self._tare = None, None
        for device in (self.devices.stages, self.devices.tracker, self.devices.sensors):
            device.connect(now)

    def _look(self, now: float) -> Trouble | None:
        """The worst that is wrong with a device, acted upon if it is more than a warning."""
        devices = self.devices
        troubles = (devices.stages.trouble(now), devices.tracker.trouble(now), devices.sensors.trouble(now))
        if troubles == (None, None, None):
            self._troubles = (0, 0, 0)
            return None
        self._troubles = tuple(0 if trouble is None else int(trouble.severity) for trouble in troubles)
        worst = max((trouble for trouble in troubles if trouble is not None), key=lambda trouble: trouble.severity)
        if worst.severity is Severity.WARN:
            return None
        event = {Severity.HOLD: Event.HOLD, Severity.STOP: Event.STOP, Severity.FAULT: Event.FAULT}[worst.severity]
        moving = self.state in (State.READY, State.RUNNING)
        if moving or (event is Event.FAULT and self.state not in (State.OFF, State.FAULT)):
            self.stop(now, event, worst.text)
        return worst

    def _go_on(self, stages: Condition) -> None:
        """States that follow by themselves."""
        if self.state is State.CONNECTING and all(
            device.condition is Condition.CONNECTED
            for device in (self.devices.stages, self.devices.tracker, self.devices.sensors)
        ):
            self.request(Event.CONNECTED)
        if self.state in (State.CONNECTED, State.HOMING) and self.devices.stages.ready:
            self.request(Event.HOMED)
        elif self.state is State.HOMING and stages is Condition.CONNECTED:
            self.request(Event.STOP)  # given up
        if self.state is State.HOMED and self._memory is not None:
            self.request(Event.PREPARE)

    def _held(self, now: float, joints: JointReading, wrenches: WrenchReading) -> Array | None:
        """The last row as it stands now: time, state and what was read go on, the estimates do not."""
        if self._row is None:
            return None
        self._row = self.channels.held(self._row, now, self.state, joints, wrenches, self._troubles)
        return self._row

    def _order(
        self, now: float, joints: JointReading, wrenches: Array, frame: TipReading | None
    ) -> Setpoint | JointMotion | None:
        """What this tick has to do, and the progress of the run."""
        if self._jog is not None:
            order = self._jog.order(now, self.controller.period)
            if order is None:
                self._finish(now)
            return order
        progress = self.progress
        if progress is None:
            self._go_on_taring(now, joints, wrenches)
            return None
        task = progress.task
        if progress.phase is Phase.APPROACHING:
            velocity = self._approach(joints.positions, task.start)
            if velocity is not None:
                return JointMotion(velocity)
            self.devices.stages.stop(now)
            self._wrenches, self._tips = [], []
            self.progress = replace(progress, phase=Phase.SETTLING, settle_start=now)
            return None
        if now < progress.motion_start - 1e-9:
            if now >= progress.settle_start + SETTLE:
                self._wrenches.append(wrenches)
                if frame is not None and self._memory is not None:
                    self._tips.append(self.controller.tip(frame.position, self._memory))
            return None
        if progress.phase is Phase.SETTLING:
            if not self._tips or self._memory is None:
                self.devices.stages.stop(now)
                self.request(Event.HOLD, f"no tracker frame in {AVERAGE:g} s; is the coil inside the tracker's volume?")
                return None
            self._tare = self.controller.tare(np.mean(self._wrenches, axis=0), joints.positions)
            self._memory = set_origin(self.controller, self._memory, np.mean(self._tips, axis=0))
            self._stall = Stall()
            self.progress = replace(progress, phase=Phase.MOVING)
        if now - progress.motion_start >= task.duration - 1e-9:
            self._finish(now)
            return None
        return task.orders.at(now - progress.motion_start)

    def _finish(self, now: float) -> None:
        self.devices.stages.stop(now)
        self.request(Event.FINISH)
        self.progress = self._jog = None

    def _go_on_taring(self, now: float, joints: JointReading, wrenches: Array) -> None:
        if self._taring_since is None:
            return
        self._wrenches.append(wrenches)
        if now - self._taring_since >= AVERAGE and self._memory is not None:
            self._tare = self.controller.tare(np.mean(self._wrenches, axis=0), joints.positions)
            self._taring_since = None
            self._memory = set_origin(self.controller, self._memory, self._memory.origin)

    def _approach(self, joints: Array, start: Array | None) -> Array | None:
        """Velocities (n,) toward the start pose, all joints arriving together; None when there."""
        if start is None:
            return None
        speed = self.controller.limits.speed
        way = (start - joints) / speed
        if np.abs(way).max() <= APPROACH_TOLERANCE:
            return None
        return way * min(APPROACH_RATE, APPROACH_SPEED / np.abs(way).max()) * speed
