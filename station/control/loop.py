"""The control loop: each tick polls the devices, executes one step of the controller, and sends the joint velocities.

The loop owns the station's state, the tare and the progress of a run; the control law is `core.control.step`. The loop
has no clock: its caller passes the time, real or virtual.
"""

from dataclasses import replace

import numpy as np

from core.control.controller_settings import Controller
from core.control.step import ControllerState, Sample, restart_setpoints_here, set_origin, start_controller, step
from core.control.stiffness import StiffnessRamp
from core.control.trajectories import JointMotion, Setpoint
from core.errors import CtrError
from core.robot.robot import Array
from station.control.contact_start import contact_start
from station.control.follow import TargetTrack
from station.control.monitors import (
    EVENT_BY_SEVERITY,
    Margins,
    ProgressMonitor,
    SnapMonitor,
    blocks_motion,
    device_faults,
    not_finite,
)
from station.control.states import AUTO_STATES, LATCHED, RefusedError, State, StopReasons, Transition, next_state
from station.control.task import (
    AVERAGE_S,
    FREEZE_AFTER_S,
    SETTLE_S,
    Jog,
    MotionTask,
    Phase,
    Progress,
    SettlePhase,
    Space,
    StreamedMotion,
    StreamLimits,
    StreamRequest,
    TimedMotion,
)
from station.control.telemetry import Channels
from station.devices.interfaces import (
    Condition,
    DeviceFault,
    Devices,
    GroundTruth,
    JointReading,
    Severity,
    TipReading,
    WrenchReading,
)

#: Error text for a jog of the tip's direction while this direction is not controlled.
NO_DIRECTION_CONTROL = (
    "the tip's direction is not controlled here; the station file's [controller] needs task ="
    " 'position_and_direction', and the robot five joints or more"
)
#: Error text for a change of the stiffness without a motion that has one.
NO_STIFFNESS = (
    "the stiffness of the tip can be changed only while a motion runs that was started with 'stiffness' in its"
    " controller"
)
#: Interval between two attempts to connect a tracker whose port is missing [s].
RECONNECT_INTERVAL_S = 1.0


class ControlLoop:
    """Control loop of one bench: its state, its commands and its tick."""

    def __init__(self, controller: Controller, devices: Devices, margins: Margins | None = None) -> None:
        self.controller = controller
        self.devices = devices
        self.state = State.OFF
        self._causes = StopReasons()
        self.progress: Progress | None = None  #: progress of the active task; None without a task
        self.channels = Channels(controller.statics.robot)
        self._margins = margins or Margins()
        self._memory: ControllerState | None = None
        self._row: Array | None = None
        self._troubles = devices.no_fault
        self._jog: Jog | None = None
        self._after_homing: MotionTask | None = None  # task to start after homing
        self._motion: TimedMotion | StreamedMotion | TargetTrack | None = None  # motion of the task in progress
        self._stiffness: StiffnessRamp | None = None  # change of the stiffness in the task in progress
        self._tare: Array | None = None
        self._rest: SettlePhase | None = None  # measurement at rest, before a motion or for a requested tare
        self._retry = 0.0  # time of the next attempt to connect a missing tracker [s]
        self._frame_at = 0.0  # arrival time of the newest tracker frame [s]
        self._stall, self._snap = ProgressMonitor(), self._snap_monitor(self._margins)
        self._target = TargetTrack()
        self._contact_start = 0.0  # start of the contact of a tip that holds a force [s]; 0 without contact
        self._no_wrenches = np.zeros((len(controller.statics.robot.tubes), 6))  # of a bench without force sensors

    @property
    def cause(self) -> str:
        """Causes of HOLD, STOPPED or FAULT: the first cause since the last reset, then later causes."""
        return str(self._causes)

    @property
    def cause_details(self) -> str:
        """Addresses and raw values that belong to the causes; empty if there are none."""
        return self._causes.details

    @property
    def phase(self) -> Phase:
        """Phase of the present run or jog."""
        if self._jog is not None:
            return Phase.JOGGING
        return self.progress.phase if self.progress else Phase.NONE

    def part_done(self, now: float) -> float:
        """Return the completed fraction of the run's motion, 0 ... 1."""
        if self.progress is None or self.progress.phase is not Phase.MOVING:
            return 0.0
        return min(1.0, max(0.0, (now - self.progress.motion_start) / self.progress.task.duration))

    # Commands

    def request(self, event: Transition, cause: str = "", details: str = "") -> None:
        """Change the state by an event; `cause` is the reason of a HOLD, STOP or FAULT, with its `details`.

        Raises:
            RefusedError: the present state does not allow the event.
        """
        before, self.state = self.state, next_state(self.state, event)
        if event in (Transition.STOP, Transition.FAULT, Transition.HOLD):
            self._causes = (self._causes if before in LATCHED else StopReasons()).add(cause, details)
            self.progress, self._jog, self._rest = None, None, None
            self._after_homing = None
            self._target.end()
        elif event in (Transition.RESET, Transition.RECONNECT, Transition.CONNECT):
            self._causes = StopReasons()

    def connect(self, now: float) -> None:
        """Search for every device and set it up; a reset from FAULT does the same.

        Raises:
            RefusedError: the state is not OFF.
        """
        self.request(Transition.CONNECT)
        self._connect(now)

    def reset(self, now: float) -> None:
        """Leave HOLD, STOPPED or FAULT after a person has acknowledged the cause.

        A device with a fault is connected again; meanwhile the station is CONNECTING and nothing moves.

        Raises:
            RefusedError: there is nothing to reset.
        """
        next_state(self.state, Transition.RESET)
        if self.state is State.FAULT:
            self.request(Transition.RESET)
            self._connect(now)
            return
        wrong = [
            device
            for kind, device in self.devices.by_kind.items()
            if kind != "stages" and blocks_motion(device.trouble(now))
        ]
        self.request(Transition.RECONNECT if wrong else Transition.RESET)
        for device in wrong:
            device.connect(now)

    def home(self, now: float, then: MotionTask | None = None) -> None:
        """Home every stage, then start the task `then`; a person has confirmed that the travel is clear.

        Raises:
            RefusedError: the state is neither CONNECTED nor READY.
            CtrError: the stages cannot home.
        """
        next_state(self.state, Transition.HOME)
        self.devices.stages.home(now)
        self._rest = None
        self.request(Transition.HOME)
        self._after_homing = then

    def stop(
        self,
        now: float,
        event: Transition = Transition.STOP,
        cause: str = "stopped by the operator",
        details: str = "",
    ) -> None:
        """Stop every axis first, then change the state."""
        self.devices.stages.stop(now)
        self.request(event, cause, details)

    def start(self, task: MotionTask) -> None:
        """Start a task: approach the start pose, rest to tare the sensors and measure the tip, then execute the motion.

        Raises:
            RefusedError: the state is not READY, or the target to follow is not measured.
        """
        if task.follow is not None and self._target.missing:
            raise RefusedError(self._target.missing)
        self.request(Transition.START)
        self._target.end()
        self.controller, self._rest, self._stiffness = task.controller, None, None
        self.progress = Progress(task, Phase.APPROACHING)
        self._snap = self._snap_monitor(task.margins or self._margins)

    def _snap_monitor(self, margins: Margins) -> SnapMonitor:
        return SnapMonitor(margins, self.controller.statics.robot.joint_names)

    def tare(self, now: float) -> None:
        """Tare the force sensors with the mean of their next readings.

        Raises:
            RefusedError: the bench has no force sensors, or the state is not READY, so the robot may move.
        """
        if self.devices.sensors is None:
            raise RefusedError("'tare' is not possible: this bench has no force sensors")
        if self.state is not State.READY:
            raise RefusedError(f"'tare' is not possible while {self.state.name}; it needs READY")
        self._rest = SettlePhase(now)

    def jog(self, now: float, space: Space, velocity: Array) -> None:
        """Start or renew a jog, which ends when it is not renewed within `JOG_TIMEOUT_S`.

        Args:
            now: time [s].
            space: what `velocity` moves; see `Space`.
            velocity: (n,) [rad/s or m/s] of the joints, (3,) [m/s] of the tip, or (3,) [rad/s] of its direction.

        Raises:
            RefusedError: the state is not READY, or the jog turns a direction that is not controlled.
        """
        if self._jog is not None and self._jog.renew(space, velocity, now):
            return
        direction = None if self._memory is None or not self.controller.aim.lever else self._memory.direction
        if space == "direction" and direction is None:
            raise RefusedError(NO_DIRECTION_CONTROL)
        self.request(Transition.START)
        self._jog = Jog(space, velocity, now, None if direction is None else direction.observed)
        self._rest = None
        if self._memory is not None:
            self._memory = restart_setpoints_here(self._memory)
        self._stall, self._snap = ProgressMonitor(), self._snap_monitor(self._margins)

    def set_stiffness(self, now: float, axes: tuple[float, float, float]) -> None:
        """Change the stiffness of the tip along its axes [N/m], within `RAMP_S`, until the end of the present motion.

        Raises:
            RefusedError: the present motion has no stiffness, or no motion runs.
            DescriptionError: the stiffness is too low for the delay of the line in the present pose.
        """
        started = None if self.progress is None else self.controller.stiffness
        if started is None or self._memory is None:
            raise RefusedError(NO_STIFFNESS)
        last = replace(started, axes=axes)
        last.check(self._memory.estimate.loaded, self.controller.force_delay)
        self._stiffness = StiffnessRamp(self._stiffness.at(now) if self._stiffness else started, last, now)

    # Tick

    def tick(self, now: float, truth: GroundTruth | None = None, request: StreamRequest | None = None) -> Array | None:
        """Execute one period of the control loop.

        Args:
            now: time of this tick [s].
            truth: ground truth of a virtual lab, for recordings only.
            request: latest setpoint request for this run's streamed tip.

        Returns:
            The row of telemetry, with the columns of `channels`. Its estimates are frozen while joint positions are
            unknown, and in a tick whose samples the controller could not use (the axes then receive a stop). The
            result is None until the controller has started.
        """
        devices, stages = self.devices, self.devices.stages
        if self.state is State.OFF and stages.condition is Condition.CLOSED:
            return None
        joints = stages.poll(now)
        frame = None if devices.tracker is None else devices.tracker.poll(now)
        wrenches = WrenchReading(now, self._no_wrenches) if devices.sensors is None else devices.sensors.poll(now)
        if frame is not None or devices.tracker is None:
            self._frame_at = now
        self._target.update(now, frame)
        fault = self._check_devices(now)
        if self.state in AUTO_STATES:
            self._auto_transitions(now, stages.condition, fault)
        if not stages.ready:
            self._memory = None
            return self._frozen_row(now, joints, wrenches)
        if self._tare is None and wrenches.usable:
            # Start with a tare by a single sample; the mean of more samples replaces it at the end of the settle phase.
            self._tare, self._rest = self.controller.tare(wrenches.wrenches, joints.positions), SettlePhase(now)
        tare = wrenches.wrenches if self._tare is None else self._tare
        order = None if fault else self._order(now, joints, wrenches.wrenches, frame, request)
        tip, age = (None, 0.0) if frame is None else (frame.position, now - frame.time)
        direction = None if frame is None else frame.direction
        sample = Sample(joints.positions, joints.sent, wrenches.wrenches - tare, tip, age, direction)
        try:
            if self._memory is None:
                if (frame is None and devices.tracker is not None) or not wrenches.usable:
                    return self._frozen_row(now, joints, wrenches)
                self._memory = start_controller(self.controller, sample)
            tick = step(self.controller, self._memory, sample, order)
        except CtrError as error:
            # This tick sends only the stop; the next tick continues from the last valid state of the controller.
            stages.stop(now)
            if self.state in (State.READY, State.RUNNING):
                cause, details = not_finite(joints, frame, wrenches)
                self.request(Transition.HOLD, cause or f"the controller cannot continue: {error}", details)
            return self._frozen_row(now, joints, wrenches)
        self._memory = tick.memory
        snap = self._snap.check(tick, frame is not None, now) if self.state in (State.RUNNING, State.HOLD) else None
        # The first tracker frames after a snap are rejected as outliers, so this STOP may follow a HOLD.
        if snap is not None and (self.state is State.RUNNING or snap.severity is Severity.STOP):
            self._act_on(snap, now)
        if self.state is State.RUNNING and isinstance(order, Setpoint) and frame is not None:
            stalled = self._stall.check(now, tick, self.controller.limits, self.controller.aim.floor)
            self._act_on(DeviceFault(Severity.HOLD, stalled) if stalled else None, now)
        if order is not None and self.state is State.RUNNING:
            stages.command(tick.command, now)
        self._contact_start = (
            0.0 if tick.setpoint.press is None else contact_start(self._contact_start, now, tick.setpoint.press, tick)
        )
        self._row = self.channels.row(
            now, self.state, self.phase, joints, wrenches, frame, tick, truth, self._troubles, request,
            self._target.numbers(truth), self._contact_start,
        )  # fmt: skip
        return self._row

    def _connect(self, now: float) -> None:
        self._memory, self._tare = None, None
        for device in self.devices.by_kind.values():
            device.connect(now)

    def _check_devices(self, now: float) -> DeviceFault | None:
        """Change the state after a fault that forbids motion; return the worst such fault, None without one."""
        self._troubles, fault = device_faults(self.devices, now)
        if fault is None or not blocks_motion(fault):
            return None
        if self.state in (State.READY, State.RUNNING) or (
            fault.severity is Severity.FAULT and self.state not in (State.OFF, State.FAULT)
        ):
            self._act_on(fault, now)
        elif self.state is State.FAULT:
            self._causes = self._causes.extend(fault.text, fault.details)
        return fault

    def _act_on(self, fault: DeviceFault | None, now: float) -> None:
        if fault is not None and self.state is not State.FAULT:
            self.stop(now, EVENT_BY_SEVERITY[fault.severity], fault.text, fault.details)

    def _auto_transitions(self, now: float, stages: Condition, fault: DeviceFault | None) -> None:
        """Change the state when the devices, the stages or the controller become ready, or homing fails."""
        if (
            self.state is State.CONNECTING
            and fault is None
            and all(device.condition is Condition.CONNECTED for device in self.devices.by_kind.values())
        ):
            self.request(Transition.CONNECTED)
        elif self.state is State.CONNECTING and now >= self._retry:
            self._retry = now + RECONNECT_INTERVAL_S
            tracker = self.devices.tracker
            if tracker is not None and tracker.condition is Condition.FAULT:
                tracker.connect(now)
        if self.state in (State.CONNECTED, State.HOMING) and self.devices.stages.ready:
            self.request(Transition.HOMED)
        elif self.state is State.HOMING and stages is Condition.CONNECTED:
            self.request(Transition.STOP)  # the stages have ended homing without positions, so homing has failed
        if self.state is State.HOMED and self._memory is not None:
            self.request(Transition.PREPARE)
            if self._after_homing is not None:
                then, self._after_homing = self._after_homing, None
                self.start(then)

    def _frozen_row(self, now: float, joints: JointReading, wrenches: WrenchReading) -> Array | None:
        """Return the last row with new time, state and readings; its estimates are frozen."""
        if self._row is None:
            return None
        self._row = self.channels.frozen_row(self._row, now, self.state, self.phase, joints, wrenches, self._troubles)
        return self._row

    def _order(
        self, now: float, joints: JointReading, wrenches: Array, frame: TipReading | None, request: StreamRequest | None
    ) -> Setpoint | JointMotion | None:
        """Return this tick's setpoint or joint velocities, and update the progress of the run; None without motion."""
        if self._jog is not None:
            order = self._jog.order(now, self.controller.period)
            if order is None:
                self._finish(now)
            return order
        progress = self.progress
        if progress is None:
            self._continue_tare(now, joints, wrenches)
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
            self._rest = SettlePhase(now)
            self.progress = replace(progress, phase=Phase.SETTLING, settle_start=now)
            return None
        if self._rest is not None:
            if now < progress.motion_start - 1e-9:
                if now >= progress.settle_start + SETTLE_S:
                    self._rest.take(wrenches, self._tip(frame))
                return None
            if not self._begin_motion(now, progress.motion_start, joints, self._rest, task):
                return None
            self.progress = replace(progress, phase=Phase.MOVING)
        if now - progress.motion_start >= task.duration - 1e-9:
            self._finish(now)
            return None
        assert self._motion is not None, "a moving run has a motion"  # noqa: S101
        # Without frames the tip's error is frozen at its last value. An observer freezes its correction itself.
        blind = now - self._frame_at
        order = self._motion.order(
            now, blind if blind > FREEZE_AFTER_S and not task.controller.observes else 0.0, request
        )
        if isinstance(order, DeviceFault):
            self._act_on(order, now)
            return None
        if order is None:
            self._finish(now)
        if isinstance(order, Setpoint) and self._stiffness is not None:
            return order._replace(stiffness=self._stiffness.at(now))
        return order

    def _begin_motion(
        self, now: float, start: float, joints: JointReading, rest: SettlePhase, task: MotionTask
    ) -> bool:
        """Set tare, start tip and motion from the measurements at rest; return False without a tracker frame."""
        tip, self._rest = rest.tip, None
        if self.devices.tracker is None and self._memory is not None:
            tip = self._memory.tip
        if tip is None or self._memory is None:
            text = f"the tracker measured no position within {AVERAGE_S:g} s; is the coil inside its volume?"
            self._act_on(DeviceFault(Severity.HOLD, text), now)
            return False
        self._tare = self.controller.tare(rest.wrenches, joints.positions)
        self._memory = set_origin(self.controller, self._memory, tip)
        self._stall, self._snap = ProgressMonitor(), self._snap_monitor(task.margins or self._margins)
        if task.follow is not None:
            self._target.follow(task.follow, task.controller, tip)
            self._motion = self._target
        elif isinstance(task.orders, StreamLimits):
            direction = self._memory.direction
            self._motion = StreamedMotion(
                task.orders, start, task.controller.period, None if direction is None else direction.origin
            )
        else:
            self._motion = TimedMotion(task.orders, start)
        return True

    def _tip(self, frame: TipReading | None) -> Array | None:
        if frame is None or self._memory is None:
            return None
        return self.controller.tip(frame.position, self._memory.estimate.loaded.rotation)

    def _finish(self, now: float) -> None:
        self.devices.stages.stop(now)
        self.request(Transition.FINISH)
        self._target.end()
        self.progress = self._jog = None

    def _continue_tare(self, now: float, joints: JointReading, wrenches: Array) -> None:
        if self._rest is None:
            return
        self._rest.take(wrenches, None)
        if now - self._rest.since >= AVERAGE_S and self._memory is not None:
            self._tare = self.controller.tare(self._rest.wrenches, joints.positions)
            self._memory = set_origin(self.controller, self._memory, self._memory.origin)
            self._rest = None
