"""The control loop: each tick polls the devices, executes one step of the controller, and sends the joint velocities.

The loop owns the station's state, the tare and the progress of a run; the control law is `core.control.step`. The loop
has no clock: its caller passes the time, real or virtual.
"""

from collections.abc import Callable
from dataclasses import replace

from core.control.controller_settings import Controller
from core.control.force_control import CONTACT, Press
from core.control.force_error import unknown_along
from core.control.step import (
    ControllerState,
    Sample,
    force_error,
    handed_over,
    restart_setpoints_here,
    set_origin,
    start_controller,
    step,
)
from core.control.stiffness import StiffnessRamp
from core.control.tip_residual import FACTOR
from core.control.trajectories import JointMotion, Setpoint
from core.errors import CtrError
from core.robot.robot import Array
from station.control.contact_start import contact_start
from station.control.contradiction import ContradictionMonitor, compared_tips
from station.control.follow import TargetTrack
from station.control.force_zero import (
    ForceZero,
    after_tare,
    contact,
    doubted,
    first_zero,
    removed_force,
    still_pressing,
)
from station.control.monitors import (
    EVENT_BY_SEVERITY,
    ForceMonitor,
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
    JogMotion,
    JogSpace,
    MotionTask,
    Phase,
    Progress,
    SettlePhase,
    StreamedMotion,
    StreamLimits,
    StreamRequest,
    TimedMotion,
)
from station.control.telemetry import Channels, TickRecord
from station.control.tracker_monitor import TrackerMonitor
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
#: Cause of a HOLD instead of a press in a direction in which the bench measures no force.
UNKNOWN_PRESS = (
    "without force sensors for the whole load, the force along the tubes is unknown, and the tip would press far too"
    " hard in this direction: press across the tubes"
)
#: Error text for a change of the stiffness without a motion that has one.
NO_STIFFNESS = (
    "the stiffness of the tip can be changed only while a motion runs that was started with 'stiffness' in its"
    " controller"
)
#: Warning after the learned residual was switched off.
RESIDUAL_OFF = (
    "the learned residual is switched off, because the tracker shows a smaller error without it: check the tracker, or"
    " repeat 'calibrate residual'"
)
#: Interval between two attempts to connect a tracker whose port is missing [s].
RECONNECT_INTERVAL_S = 1.0


class ControlLoop:
    """Control loop of one bench: its state, its commands and its tick."""

    def __init__(
        self,
        controller: Controller,
        devices: Devices,
        margins: Margins | None = None,
        watched: Callable[[Controller], Controller] = lambda controller: controller,
    ) -> None:
        """Prepare a loop that is OFF; `watched` returns a controller with timing around its custom loops."""
        self._watched, self._own = watched, watched(controller)
        self.controller = self._own  #: controller of the present run, or the station's own one
        self.run = 0  #: number of the run whose task is in progress or was the last one; 0: none
        self.devices = devices
        self.state = State.OFF
        self._time = 0.0  # time of the last tick [s]
        self._causes = StopReasons()
        self.progress: Progress | None = None  #: progress of the active task; None without a task
        self.channels = Channels(controller.statics.robot)
        self._margins = margins or Margins()
        self._memory: ControllerState | None = None
        self._row: Array | None = None
        self._troubles = devices.no_fault
        self._jog: JogMotion | None = None
        self._after_homing: MotionTask | None = None  # task to start after homing
        self._motion: TimedMotion | StreamedMotion | TargetTrack | None = None  # motion of the task in progress
        self._stiffness: StiffnessRamp | None = None  # change of the stiffness in the task in progress
        self._tare: Array | None = None
        self._tared = False  # whether the sensors have been tared since the last connection
        self._zero: ForceZero | None = None  # zero of the force; None: no force is known
        self._moved = False  # whether anything has moved since the first reading
        self._overload = ForceMonitor()
        self._pressed: Array | None = None  # force (3,) of a press that has not left its obstacle [N]
        self.contact = ""  #: why the tip may have contact after the last motion, tare or reset; empty without contact
        self._rest: SettlePhase | None = None  # measurement at rest, before a motion or for a requested tare
        self._retry = 0.0  # time of the next attempt to connect a missing tracker [s]
        self._frame_at = 0.0  # arrival time of the newest tracker frame [s]
        self._stall, self._snap = ProgressMonitor(), self._snap_monitor(self._margins)
        self._frames, self._contradiction = TrackerMonitor(), ContradictionMonitor(self._margins.unexplained)
        self._target = TargetTrack()
        self._contact_start = 0.0  # start of the contact of a tip that holds a force [s]; 0 without contact
        self._no_wrenches = controller.no_zeros  # readings of a bench without force sensors
        self._change = self._no_wrenches  # newest readings of the sensors minus the tare (q, 6) [N, N m]

    @property
    def cause(self) -> str:
        """Causes of HOLD, STOPPED or FAULT: the first cause since the last reset, then later causes."""
        return str(self._causes)

    @property
    def warning(self) -> str:
        """Warnings about the tracker's noise and the controller's model; empty without one."""
        if self._memory is None:
            return ""
        corrects = self.controller.estimator.residual is not None
        off = corrects and self._memory.estimate.known.residual_state[FACTOR] < 1.0
        return "; ".join(filter(None, (self._frames.warning, RESIDUAL_OFF if off else "")))

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

    @property
    def total_force(self) -> Array | None:
        """Mean force on the tip (3,) with what tares removed, compared with its bound [N]; None: unknown."""
        return self._overload.force

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
            self._use(self._own)
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
        self.contact = self._contact(now)
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
            RefusedError: the state is neither CONNECTED nor READY, or the tip has contact.
            CtrError: the stages cannot home.
        """
        next_state(self.state, Transition.HOME)
        self._refuse_contact(now)
        self._end_rest()
        self._moved = True
        self.devices.stages.home(now)
        self.request(Transition.HOME)
        self._after_homing, self.run = then, 0 if then is None else then.run

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

    def wake(self, now: float, slept: float) -> None:
        """Stop every axis after the computer has slept for `slept` [s], in which no program could stop them."""
        if self.state in (State.READY, State.RUNNING, State.HOMING):
            moved = "" if self.state is State.READY else "; the stages may have moved meanwhile"
            event = Transition.STOP if self.state is State.HOMING else Transition.HOLD
            self.stop(now, event, f"this computer has slept for {slept:.3g} s{moved}: check the robot")

    def start(self, task: MotionTask) -> None:
        """Start a task: approach the start pose, rest to tare the sensors and measure the tip, then execute the motion.

        Raises:
            RefusedError: the state is not READY, the target to follow is not measured, the force on the tip is above
                its bound, or the tip has contact, which the tare of the task would hide.
        """
        next_state(self.state, Transition.START)
        if task.follow is not None and self._target.missing:
            raise RefusedError(self._target.missing)
        if excess := self._overload.begin(jog=False):
            raise RefusedError(excess)
        if task.rests and not task.loaded:
            self._refuse_contact(self._time)
        self.request(Transition.START)
        task = replace(task, controller=self._watched(task.controller))
        self.run = task.run
        self._target.end()
        self._end_rest()
        self._use(task.controller)
        self.contact = ""
        self.progress = Progress(task, Phase.APPROACHING)
        self._snap = self._snap_monitor(task.margins or self._margins)

    def _use(self, controller: Controller) -> None:
        """Continue with the controller of a run, or after it with the station's own one."""
        if controller is not self.controller and self._memory is not None:
            self._memory = handed_over(controller, self._memory)
        self.controller, self._stiffness = controller, None

    def _begin_monitors(self, margins: Margins) -> None:
        self._stall, self._snap = ProgressMonitor(), self._snap_monitor(margins)
        self._frames.begin()
        self._contradiction = ContradictionMonitor(margins.unexplained)

    def _snap_monitor(self, margins: Margins) -> SnapMonitor:
        return SnapMonitor(margins, self.controller, knows_force=self.controller.senses)

    def tare(self, now: float, *, untouched: bool = False) -> None:
        """Tare the force sensors with the mean of their next readings.

        With `untouched` a person confirms that nothing touches the robot, so the tare may remove any force. On a bench
        without sensors it then sets the force from the deflection to zero.

        Raises:
            RefusedError: the bench has no force sensors for the whole load, or the tip has contact.
        """
        if not self.controller.senses and not (untouched and self._zero is not None):
            instead = "" if self._zero is None else "; with 'untouched' it sets the force from the deflection to zero"
            raise RefusedError(f"'tare' is not possible: this bench has no force sensors for the whole load{instead}")
        if not untouched:
            self._refuse_contact(now)
        self._rest = SettlePhase(now, untouched=untouched)

    def _refuse_contact(self, now: float) -> None:
        self.contact = self._contact(now)
        if self.contact:
            raise RefusedError(self.contact)

    def _contact(self, now: float) -> str:
        """Return why the tip may have contact; empty without contact and while no force is known."""
        zero, memory, total = self._zero, self._memory, self._overload.force
        if zero is None or memory is None or total is None:
            return ""
        loaded = memory.estimate.loaded
        removed = removed_force(self.controller, zero, loaded)
        if self._pressed is not None:
            if pressing := still_pressing(self._pressed, total - removed):
                return pressing
            self._pressed = None
        return contact(self.controller, zero, self._change, total - removed, removed, loaded.joints, now)

    def _end_rest(self) -> None:
        """End an unfinished tare before a motion; if nothing has moved so far, its readings become the zero."""
        rest, self._rest = self._rest, None
        if rest is None or self._zero is None or self._moved or not self.controller.senses:
            return
        if rest.counted and not rest.unrest:
            free = self.controller.tare(rest.wrenches, self._zero.joints)
            self._zero = replace(self._zero, free=free)

    def jog(self, now: float, space: JogSpace, request: Array) -> None:
        """Start or renew a jog, which ends if it is not renewed within `JOG_TIMEOUT_S`.

        Args:
            now: time [s].
            space: what the request moves, see `Space`; or 'pose'.
            request: velocity (n,) [rad/s or m/s] of the joints, (3,) [m/s] of the tip, or (3,) [rad/s] of its
                direction; for 'pose', joint positions (n,) [rad or m] to which the joints move and where they rest.

        Raises:
            RefusedError: the state is not READY, or the jog turns a direction that is not controlled.
            ContractError: a custom loop cannot be reset.
        """
        if self._jog is not None and self._jog.renew(space, request, now):
            return
        direction = None if self._memory is None or not self.controller.aim.lever else self._memory.direction
        if space == "direction" and direction is None:
            raise RefusedError(NO_DIRECTION_CONTROL)
        self.controller.reset()
        self.request(Transition.START)
        self._overload.begin(jog=True)
        self.contact = ""
        self._jog = JogMotion(space, request, now, None if direction is None else direction.observed)
        self._end_rest()
        if self._memory is not None:
            self._memory = restart_setpoints_here(self._memory)
        self._begin_monitors(self._margins)

    def set_stiffness(self, now: float, axes: tuple[float, float, float]) -> None:
        """Change the stiffness of the tip along its axes [N/m], within `RAMP_S`, until the end of the present motion.

        Raises:
            RefusedError: the present motion has no stiffness, or no motion runs.
            DescriptionError: in the present pose the stiffness is too low for the delay of the joints' response.
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
        self._time = now
        if not stages.ready:
            self._memory, self._overload.force = None, None
            return self._frozen_row(now, joints, wrenches)
        if not self._tared and wrenches.usable:
            # Start with a tare by a single sample; the mean of more samples replaces it at the end of the settle phase.
            # After a new connection the last tare remains until then, because something may touch the robot.
            self._tared, self._rest = True, SettlePhase(now)
            if self._tare is None:
                self._tare = self.controller.tare(wrenches.wrenches, joints.positions)
                if self.controller.senses:
                    self._moved = False
                    self._zero = first_zero(self.controller, self._tare, joints.positions, now)
        tare = wrenches.wrenches if self._tare is None else self._tare
        order = None if fault else self._order(now, joints, wrenches, frame, request)
        tip, age = (None, 0.0) if frame is None else (frame.position, now - frame.time)
        direction = None if frame is None else frame.direction
        measured = wrenches.wrenches - tare if self.controller.senses else self._no_wrenches
        self._change = measured
        sample = Sample(joints.positions, joints.sent, measured, tip, age, direction)
        try:
            if self._memory is None:
                if (frame is None and devices.tracker is not None) or not wrenches.usable:
                    return self._frozen_row(now, joints, wrenches)
                self._memory = start_controller(self.controller, sample)
                self._compare_tips(self._memory, now)
            tick = step(self.controller, self._memory, sample, order)
        except CtrError as error:
            # This tick sends only the stop; the next tick continues from the last valid state of the controller.
            stages.stop(now)
            if self.state in (State.READY, State.RUNNING):
                cause, details = not_finite(joints, frame, wrenches)
                self.request(Transition.HOLD, cause or f"the controller cannot continue: {error}", details)
            return self._frozen_row(now, joints, wrenches)
        self._memory = tick.memory
        snap = None
        if self.state in (State.RUNNING, State.HOLD):
            by_tracker = isinstance(order, Setpoint) and devices.tracker is not None
            snap = self._snap.check(tick, frame is not None, now, joints.sent, tip=by_tracker)
        # The first tracker frames after a snap are rejected as outliers, so this STOP may follow a HOLD.
        if snap is not None and (self.state is State.RUNNING or snap.severity is Severity.STOP):
            self._act_on(snap, now)
        if frame is not None:
            self._frames.update(self.controller.estimator.observer, tick.memory.estimate.observed, tick.memory.tip, age)
            if self.state is State.RUNNING and isinstance(order, Setpoint):
                cause = (
                    self._frames.check()
                    or self._contradiction.check(compared_tips(self.controller, tick, measured), now, age)
                    or self._stall.check(now, tick, self.controller.limits, self.controller.aim.floor)
                )
                self._act_on(DeviceFault(Severity.HOLD, cause) if cause else None, now)
        if self._zero is not None:
            removed = removed_force(self.controller, self._zero, tick.memory.estimate.loaded)
            error = force_error(self.controller, tick.memory)
            self._overload.update(now, tick.load.force + removed, self.controller.limits.overload, error)
            if tick.setpoint.press is not None and self._overload.force is not None:
                touches = tick.memory.contact.force > CONTACT * tick.setpoint.press.force
                self._pressed = self._overload.force - removed if touches else None
        if order is not None and self.state is State.RUNNING and (excess := self._overload.check(now)):
            self._act_on(DeviceFault(Severity.HOLD, excess), now)
        if order is not None and self.state is State.RUNNING:
            self._moved = True
            stages.command(tick.command, now)
        self._contact_start = (
            0.0 if tick.setpoint.press is None else contact_start(self._contact_start, now, tick.setpoint.press, tick)
        )
        record = TickRecord(
            now, self.state, self.phase, joints, wrenches, frame, tick, tick.memory, tick.memory.estimate, truth,
            self._troubles, None if request is None else request.setpoint, self._target.values(truth),
            self._contact_start, self._overload.possible,
        )  # fmt: skip
        self._row = self.channels.row(record)
        return self._row

    def _connect(self, now: float) -> None:
        self._memory, self._tared = None, False
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
        self,
        now: float,
        joints: JointReading,
        wrenches: WrenchReading,
        frame: TipReading | None,
        request: StreamRequest | None,
    ) -> Setpoint | JointMotion | None:
        """Return this tick's setpoint or joint velocities, and update the progress of the run; None without motion."""
        if self._jog is not None:
            order = self._jog.order(now, self.controller.period, joints.positions, self.controller.limits.speed)
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
            if unrest := self._rest.unrest:
                self._rest = self._rest.again(now)
                if self._rest is None:
                    self._act_on(DeviceFault(Severity.HOLD, unrest), now)
                else:
                    self.progress = replace(progress, settle_start=now)
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
        """Set tare, start tip and motion from the measurements at rest; return False if the motion cannot start."""
        tip, self._rest = rest.tip, None
        if self.devices.tracker is None and self._memory is not None:
            tip = self._memory.tip
        if tip is None or self._memory is None:
            text = f"the tracker measured no position within {AVERAGE_S:g} s; is the coil inside its volume?"
            self._act_on(DeviceFault(Severity.HOLD, text), now)
            return False
        if task.press is not None and self._unknown(task.press):
            self._act_on(DeviceFault(Severity.HOLD, UNKNOWN_PRESS), now)
            return False
        if refused := self._set_zero(now, rest, joints, tip, loaded=task.loaded):
            self._act_on(DeviceFault(Severity.HOLD, f"a tare would hide a contact: {refused}"), now)
            return False
        try:
            task.controller.reset()
        except CtrError as error:
            self._act_on(DeviceFault(Severity.HOLD, str(error)), now)
            return False
        self._begin_monitors(task.margins or self._margins)
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

    def _unknown(self, press: Press) -> bool:
        """Return whether the bench cannot measure the force of a press."""
        deflection = None if self.controller.senses or self._memory is None else self._memory.deflection
        return deflection is not None and unknown_along(deflection, press.direction)

    def _set_zero(
        self, now: float, rest: SettlePhase, joints: JointReading, tip: Array, *, loaded: bool = False,
        untouched: bool = False,
    ) -> str:  # fmt: skip
        """Tare with the readings at rest and restart the estimates at `tip` (3,); return why if it would hide a load.

        `loaded`: remove a known load, which still counts in the bound of the force; `untouched`: remove any force.
        """
        memory, zero = self._memory, self._zero
        assert memory is not None, "a tare needs the controller's state"  # noqa: S101
        tare, free = self.controller.tare(rest.wrenches, joints.positions), memory.estimate.unloaded
        if zero is not None:
            readings = tare if self.controller.senses else tip - free.tip
            after, refused = after_tare(self.controller, zero, readings, free, now, first=not self._moved)
            if refused and not (loaded or untouched):
                return refused
            self._zero = ForceZero(readings, readings, free.joints.copy(), now) if untouched else after
        self._tare, self._pressed = tare, None
        self._memory = set_origin(self.controller, memory, tip)
        return ""

    def _compare_tips(self, memory: ControllerState, now: float) -> None:
        """Compare the tracker's tip with the unloaded model before anything moves: the first tare would hide a load.

        On a bench without force sensors the difference of the tips is the reading that a tare sets to zero.
        """
        if memory.deflection is None:
            return
        difference = memory.tip - memory.estimate.unloaded.tip
        joints = memory.estimate.loaded.joints
        if not self.controller.senses and self._zero is None:
            self._moved, self._zero = False, first_zero(self.controller, difference, joints, now)
        elif not self.controller.senses and self._zero is not None:
            self._zero = replace(self._zero, tare=difference, joints=joints.copy())
        if self._zero is not None and not self._moved:
            self._zero = doubted(self._zero, difference, memory.estimate.unloaded)

    def _tip(self, frame: TipReading | None) -> Array | None:
        if frame is None or self._memory is None:
            return None
        return self.controller.tip(frame.position, self._memory.estimate.loaded.rotation)

    def _finish(self, now: float) -> None:
        self.devices.stages.stop(now)
        self.request(Transition.FINISH)
        self._target.end()
        self._use(self._own)
        self.progress = self._jog = None
        self.contact = self._contact(now)

    def _continue_tare(self, now: float, joints: JointReading, wrenches: WrenchReading) -> None:
        if self._rest is None:
            return
        self._rest.take(wrenches, None)
        if now - self._rest.since < AVERAGE_S or self._memory is None:
            return
        if unrest := self._rest.unrest:
            self._rest, self.contact = self._rest.again(now), unrest
        else:
            rest, self._rest = self._rest, None
            tip = self._memory.estimate.observed.tip if self._moved else self._memory.origin
            self.contact = self._set_zero(now, rest, joints, tip, untouched=rest.untouched)
