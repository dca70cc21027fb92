"""The control loop: at every tick poll the devices, take one step of the controller, send, report.

It holds the state, the tare and the progress of a run; the mathematics is `core.control.step`. It knows no
clock: whoever paces it says what time it is, real or virtual.
"""

from dataclasses import replace

from core.control.step import Controller, ControllerState, Sample, begin, from_here, set_origin, step
from core.control.trajectories import JointMotion, Setpoint
from core.errors import CtrError
from core.robot.robot import Array
from station.control.causes import Causes
from station.control.follow import Target
from station.control.jog import Jog, Space
from station.control.led import Asked, Lead, LedMotion
from station.control.margins import Margins, SnapMonitor
from station.control.motion import FREEZE, Motion, TimedMotion
from station.control.progress_monitor import ProgressMonitor
from station.control.settle_and_tare import AVERAGE, SETTLE, Rest
from station.control.states import LATCHED, Event, RefusedError, State, after
from station.control.task import Phase, Progress, Task
from station.control.telemetry import Channels
from station.control.troubles import EVENTS, NONE, holds, not_finite, severities, troubles, worst
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

#: Why nobody turns the tip by hand.
NOT_POINTED = (
    "where the tip points is not controlled here; the station file's [controller] needs task ="
    " 'position_and_direction', and the robot five joints or more"
)
#: A tracker whose port is not there is looked for so often, once a person has asked for it [s].
RETRY = 1.0


class ControlLoop:
    """One bench under control."""

    def __init__(self, controller: Controller, devices: Devices, margins: Margins | None = None) -> None:
        self.controller = controller
        self.devices = devices
        self.state = State.OFF
        self._causes = Causes()
        self.progress: Progress | None = None  #: of the task that is on
        self.channels = Channels(controller.statics.robot)
        self._margins = margins or Margins()
        self._memory: ControllerState | None = None
        self._row: Array | None = None
        self._troubles = NONE
        self._jog: Jog | None = None
        self._once_homed: Task | None = None  # what follows by itself
        self._motion: Motion | None = None  # of the task that is on, once it moves
        self._tare: Array | None = None
        self._rest: Rest | None = None  # before a motion, or for a tare that was asked for
        self._retry = 0.0  # when a tracker that is not there is looked for again [s]
        self._frame_at = 0.0  # when the newest frame has come [s]
        self._stall, self._snap = ProgressMonitor(), SnapMonitor(self._margins)
        self._target = Target()

    @property
    def cause(self) -> str:
        """Why the state is HOLD, STOPPED or FAULT: the first cause since the last reset, then what came later."""
        return str(self._causes)

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
        before, self.state = self.state, after(self.state, event)
        if event in (Event.STOP, Event.FAULT, Event.HOLD):
            self._causes = (self._causes if before in LATCHED else Causes()).add(cause)
            self.progress, self._jog, self._rest = None, None, None
            self._once_homed = None
            self._target.end()
        elif event in (Event.RESET, Event.RECONNECT, Event.CONNECT):
            self._causes = Causes()

    def connect(self, now: float) -> None:
        """Find every device and set it up; a reset after a fault does the same.

        Raises:
            RefusedError: not OFF.
        """
        self.request(Event.CONNECT)
        self._connect(now)

    def reset(self, now: float) -> None:
        """A person has seen the hold, the stop or the fault.

        A device that is not right is connected again; until it is, the station is CONNECTING and nothing moves.

        Raises:
            RefusedError: there is nothing to reset.
        """
        after(self.state, Event.RESET)
        if self.state is State.FAULT:
            self.request(Event.RESET)
            self._connect(now)
            return
        wrong = [d for d in (self.devices.tracker, self.devices.sensors) if holds(d.trouble(now))]
        self.request(Event.RECONNECT if wrong else Event.RESET)
        for device in wrong:
            device.connect(now)

    def home(self, now: float, then: Task | None = None) -> None:
        """Home every stage, and `then` carry that out; a person has said that the way is clear.

        Raises:
            RefusedError: neither CONNECTED nor READY.
            CtrError: the stages cannot.
        """
        after(self.state, Event.HOME)
        self.devices.stages.home(now)
        self._rest = None
        self.request(Event.HOME)
        self._once_homed = then

    def stop(self, now: float, event: Event = Event.STOP, cause: str = "stopped by the operator") -> None:
        """Stop every axis first, then change the state."""
        self.devices.stages.stop(now)
        self.request(event, cause)

    def start(self, task: Task) -> None:
        """Go to the start pose, rest there for tare and start tip, then carry out the motion.

        Raises:
            RefusedError: not READY, or it should follow a target that nobody sees.
        """
        if task.follow is not None and self._target.missing:
            raise RefusedError(self._target.missing)
        self.request(Event.START)
        self._target.end()
        self.controller, self._rest = task.controller, None
        self.progress = Progress(task, Phase.APPROACHING)
        self._snap = SnapMonitor(task.margins or self._margins)

    def tare(self, now: float) -> None:
        """Take what the force sensors feel in the next moments as zero.

        Raises:
            RefusedError: not READY, so perhaps not at rest.
        """
        if self.state is not State.READY:
            raise RefusedError(f"'tare' is not possible while {self.state.name}; it needs READY")
        self._rest = Rest(now)

    def jog(self, now: float, space: Space, velocity: Array) -> None:
        """Move by hand, or go on with it: ends by itself when this is not called again soon.

        Args:
            now: time [s].
            space: what `velocity` is of.
            velocity: (n,) [rad/s or m/s] of the joints, (3,) [m/s] of the tip, or (3,) [rad/s] of its direction.

        Raises:
            RefusedError: not READY, or a jog in direction where that is not controlled.
        """
        if self._jog is not None and self._jog.renew(space, velocity, now):
            return
        pointed = None if self._memory is None or not self.controller.aim.lever else self._memory.pointed
        if space == "direction" and pointed is None:
            raise RefusedError(NOT_POINTED)
        self.request(Event.START)
        self._jog = Jog.begin(space, velocity, now, None if pointed is None else pointed.observed)
        self._rest = None
        if self._memory is not None:
            self._memory = from_here(self._memory)
        self._stall, self._snap = ProgressMonitor(), SnapMonitor(self._margins)

    # A period

    def tick(self, now: float, truth: Truth | None = None, asked: Asked | None = None) -> Array | None:
        """One period.

        Args:
            now: time of this tick [s].
            truth: what a virtual lab knows, for the record only.
            asked: what was asked of this run's tip last, if it is led.

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
        if frame is not None:
            self._frame_at = now
        self._target.see(now, frame)
        trouble = self._look(now)
        self._go_on(now, stages.condition, trouble)
        if not stages.ready:
            self._memory = None
            return self._held(now, joints, wrenches)
        if self._tare is None and wrenches.usable:
            # One sample for a beginning; the mean of more follows.
            self._tare, self._rest = self.controller.tare(wrenches.wrenches, joints.positions), Rest(now)
        tare = wrenches.wrenches if self._tare is None else self._tare
        order = None if trouble else self._order(now, joints, wrenches.wrenches, frame, asked)
        tip, age = (None, 0.0) if frame is None else (frame.position, now - frame.time)
        direction = None if frame is None else frame.direction
        sample = Sample(joints.positions, joints.sent, wrenches.wrenches - tare, tip, age, direction)
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
                self.request(Event.HOLD, not_finite(joints, frame, wrenches) or str(error))
            return self._held(now, joints, wrenches)
        self._memory = tick.memory
        snap = self._snap.look(tick, frame is not None) if self.state in (State.RUNNING, State.HOLD) else None
        # A snap blinds the tracker first, which does not believe in jumps: STOP may follow a HOLD.
        if snap is not None and (self.state is State.RUNNING or snap.severity is Severity.STOP):
            self._act_on(snap, now)
        if self.state is State.RUNNING and isinstance(order, Setpoint) and frame is not None:
            stalled = self._stall.look(now, tick, self.controller.limits, self.controller.aim.floor)
            self._act_on(Trouble(Severity.HOLD, stalled) if stalled else None, now)
        if order is not None and self.state is State.RUNNING:
            stages.command(tick.command, now)
        target = self._target.numbers(truth)
        self._row = self.channels.row(
            now, self.state, self.phase, joints, wrenches, frame, tick, truth, self._troubles, asked, target
        )
        return self._row

    def _connect(self, now: float) -> None:
        self._memory, self._tare = None, None
        for device in (self.devices.stages, self.devices.tracker, self.devices.sensors):
            device.connect(now)

    def _look(self, now: float) -> Trouble | None:
        """The worst that is wrong with a device, acted upon if it is more than a warning."""
        found = troubles(self.devices, now)
        trouble = worst(found)
        if trouble is None:
            self._troubles = NONE
            return None
        self._troubles = severities(found)
        if not holds(trouble):
            return None
        if self.state in (State.READY, State.RUNNING) or (
            trouble.severity is Severity.FAULT and self.state not in (State.OFF, State.FAULT)
        ):
            self._act_on(trouble, now)
        elif self.state is State.FAULT:
            self._causes = self._causes.extend(trouble.text)
        return trouble

    def _act_on(self, trouble: Trouble | None, now: float) -> None:
        if trouble is not None and self.state is not State.FAULT:
            self.stop(now, EVENTS[trouble.severity], trouble.text)

    def _go_on(self, now: float, stages: Condition, trouble: Trouble | None) -> None:
        """States that follow by themselves."""
        if (
            self.state is State.CONNECTING
            and trouble is None
            and all(
                device.condition is Condition.CONNECTED
                for device in (self.devices.stages, self.devices.tracker, self.devices.sensors)
            )
        ):
            self.request(Event.CONNECTED)
        elif self.state is State.CONNECTING and now >= self._retry:
            self._retry = now + RETRY
            if self.devices.tracker.condition is Condition.FAULT:
                self.devices.tracker.connect(now)
        if self.state in (State.CONNECTED, State.HOMING) and self.devices.stages.ready:
            self.request(Event.HOMED)
        elif self.state is State.HOMING and stages is Condition.CONNECTED:
            self.request(Event.STOP)  # given up
        if self.state is State.HOMED and self._memory is not None:
            self.request(Event.PREPARE)
            if self._once_homed is not None:
                then, self._once_homed = self._once_homed, None
                self.start(then)

    def _held(self, now: float, joints: JointReading, wrenches: WrenchReading) -> Array | None:
        """The last row as it stands now: time, state and what was read go on, the estimates do not."""
        if self._row is None:
            return None
        self._row = self.channels.held(self._row, now, self.state, self.phase, joints, wrenches, self._troubles)
        return self._row

    def _order(
        self, now: float, joints: JointReading, wrenches: Array, frame: TipReading | None, asked: Asked | None
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
            velocity = task.approach(joints.positions)
            if velocity is not None:
                return JointMotion(velocity)
            if not task.rests:
                self._finish(now)
                return None
            self.devices.stages.stop(now)
            self._rest = Rest(now)
            self.progress = replace(progress, phase=Phase.SETTLING, settle_start=now)
            return None
        if self._rest is not None:
            if now < progress.motion_start - 1e-9:
                if now >= progress.settle_start + SETTLE:
                    self._rest.take(wrenches, self._tip(frame))
                return None
            if not self._set_out(now, progress.motion_start, joints, self._rest, task):
                return None
            self.progress = replace(progress, phase=Phase.MOVING)
        if now - progress.motion_start >= task.duration - 1e-9:
            self._finish(now)
            return None
        assert self._motion is not None, "a run that moves has set out"  # noqa: S101
        # Without frames the error of the last one stands; an observer sees to that itself: its correction stands.
        blind = now - self._frame_at
        order = self._motion.order(now, blind if blind > FREEZE and not task.controller.observes else 0.0, asked)
        if isinstance(order, Trouble):
            self._act_on(order, now)
            return None
        if order is None:
            self._finish(now)
        return order

    def _set_out(self, now: float, start: float, joints: JointReading, rest: Rest, task: Task) -> bool:
        """Tare, start tip and the motion, from what was measured at rest; False when the tracker saw nothing."""
        tip, self._rest = rest.tip, None
        if tip is None or self._memory is None:
            text = f"no tracker frame in {AVERAGE:g} s; is the coil inside the tracker's volume?"
            self._act_on(Trouble(Severity.HOLD, text), now)
            return False
        self._tare = self.controller.tare(rest.wrenches, joints.positions)
        self._memory = set_origin(self.controller, self._memory, tip)
        self._stall, self._snap = ProgressMonitor(), SnapMonitor(task.margins or self._margins)
        if task.follow is not None:
            self._target.follow(task.follow, task.controller, tip)
            self._motion = self._target
        elif isinstance(task.orders, Lead):
            pointed = self._memory.pointed
            self._motion = LedMotion(
                task.orders, start, task.controller.period, None if pointed is None else pointed.origin
            )
        else:
            self._motion = TimedMotion(task.orders, start)
        return True

    def _tip(self, frame: TipReading | None) -> Array | None:
        if frame is None or self._memory is None:
            return None
        return self.controller.tip(frame.position, self._memory)

    def _finish(self, now: float) -> None:
        self.devices.stages.stop(now)
        self.request(Event.FINISH)
        self._target.end()
        self.progress = self._jog = None

    def _go_on_taring(self, now: float, joints: JointReading, wrenches: Array) -> None:
        if self._rest is None:
            return
        self._rest.take(wrenches, None)
        if now - self._rest.since >= AVERAGE and self._memory is not None:
            self._tare = self.controller.tare(self._rest.wrenches, joints.positions)
            self._memory = set_origin(self.controller, self._memory, self._memory.origin)
            self._rest = None
