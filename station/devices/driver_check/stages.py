"""Checks whether a driver of stages meets the requirements, on real or simulated stages.

The checks act like the control loop. They end as soon as positions cannot be trusted or an axis is too fast.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from scipy.stats import theilslopes  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import JointFile
from station.devices.driver_check.calls import Calls
from station.devices.driver_check.requirements import (
    CONNECT_S,
    FROZEN_S,
    HOME_S,
    MAX_EMERGENCY_STOP_S,
    MAX_SPEED_ERROR,
    MAX_STOP_S,
    Broken,
    Finding,
    Must,
    one_finding_each,
)
from station.devices.guard import DriverError, joint_reading
from station.devices.interfaces import Clock, Condition, DeviceFault, EmergencyStop, JointReading, Stages

SPEED, RUN_S = 0.3, 1.0  #: speed of the first joint as a share of its largest speed, and duration of a motion [s]
TRAVEL = 0.4  #: largest share of a joint's travel that one motion may take
STILL = 50.0  #: largest change of a position that counts as rest [microsteps]
FROZEN_POLLS = 50  #: polls without a new position after which it may count as frozen; a busy computer polls rarely
TOO_FAST, TOO_FAST_S = 1.5, 0.4  #: mean speed that ends the check, as a multiple of the limit; time of the mean [s]


def check_stages(
    opens: Callable[[], Stages], joints: Sequence[JointFile], clock: Clock, stop: EmergencyStop | None, moves: bool
) -> Iterator[Finding]:
    """Check a driver of stages; `moves` permits motions, including the homing. The stages are closed at the end."""
    run = _Run(opens, joints, clock, stop)
    return one_finding_each("stages", _checks(run, moves), run.end, moves)


def _checks(run: "_Run", moves: bool) -> Iterator[Finding]:
    run.open()
    positions, ready = run.reading.positions, run.stages.ready
    good = bool(np.isnan(positions).all()) and not ready
    yield Finding(Must.UNKNOWN, good, f"positions {positions}, ready {ready}")
    obeys = moves and not ready and run.obeys_command()
    took = run.connect()
    obeys = obeys or (moves and not run.stages.ready and run.obeys_command())
    run.poll_for(0.2)
    yield run.rest(0.5)
    if moves:
        text = "an axis receives a velocity while the stages are not ready" if obeys else "have no effect"
        yield Finding(Must.NOT_READY, not obeys, text)
        yield run.home()
        yield from _motions(run)
        yield _emergency_stop(run)
        yield Finding(Must.FRESH, True, "the positions of moving axes changed, and did not jump")
    yield Finding(Must.CONNECTION, True, f"connected after {took:.2f} s, and no fault until the end")
    yield Finding(Must.FINITE, True, "finite until the end")
    yield run.calls.duration()


def _motions(run: "_Run") -> Iterator[Finding]:
    run.poll_for(0.2, np.zeros(len(run.joints)))
    velocities, seconds = run.motion(SPEED)
    start, before = run.now, run.reading.positions
    run.poll_for(0.5 * seconds, velocities)  # the stages accelerate, so only the second half shows their speed
    since = run.read_at
    run.poll_for(0.5 * seconds, velocities)
    speeds, sent = run.speeds_since(since), run.reading.sent
    if not sent.all():
        raise Broken(Must.SPEED, f"sends {sent} instead of {velocities}: {run.cause}")
    wrong, error = (float(np.abs(a / b - 1.0).max()) for a, b in ((sent, velocities), (speeds, sent)))
    # A motion that starts with a ramp of constant acceleration is late by half of the ramp's duration.
    needed = (run.reading.positions - before) / velocities
    lost = run.read_at - start - needed - 0.5 * np.abs(velocities) / run.accelerations
    text = (
        f"`sent` differs by {100.0 * wrong:.1f} % from the command, the motion by {100.0 * error:.1f} % from `sent`;"
        f" the motion starts about {1e3 * max(0.0, float(lost.max())):.0f} ms after the command"
    )
    if max(wrong, error) > MAX_SPEED_ERROR:
        raise Broken(Must.SPEED, text)  # the axes are not where the following checks expect them
    yield Finding(Must.SPEED, True, text)
    run.stages.stop(run.now)
    yield (stopped := run.stopped(Must.STOP, velocities))
    if not stopped.good:
        return  # only the emergency stop is left to check
    run.poll_for(0.5, velocities)
    velocities[0] = math.nan
    try:
        run.poll_for(0.01, velocities)
        finding = run.stopped(Must.VELOCITY_NAN, run.motion(SPEED)[0])
    except (Broken, DriverError) as error:
        raise Broken(Must.VELOCITY_NAN, f"after a velocity NaN: {error}") from error
    yield finding
    run.stop()
    velocities, seconds = run.motion(2.0)
    start, share = run.now, 0.0
    while run.now - start < seconds and share <= 1.01:
        run.poll_for(0.01, velocities)
        share = float((np.abs(run.reading.sent) / run.speeds).max())
    run.stop()
    text = f"sends at most {100.0 * share:.0f} % of the largest speed of a joint when commanded 200 %"
    yield Finding(Must.SPEED_LIMIT, share <= 1.01, text)


def _emergency_stop(run: "_Run") -> Finding:
    if run.emergency_stop is None:
        run.stop()
        return Finding(Must.EMERGENCY_STOP, False, "the driver has no `emergency_stop`: a crash leaves axes moving")
    velocities, _ = run.motion(SPEED)
    run.poll_for(0.2, velocities)
    before = run.reading.positions
    run.close()
    start, confirmed = run.now, False
    try:
        text = run.emergency_stop(run.clock)
        confirmed = isinstance(text, str) and bool(text.strip()) and run.now - start <= MAX_EMERGENCY_STOP_S
    except (Exception, SystemExit) as error:  # a foreign function can raise anything
        text = f"{type(error).__name__}: {error}"
    took = run.now - start
    # A new connection may stop the axes, too. So the distance shows whether the emergency stop has stopped them.
    run.clock.sleep(0.5 + run.braking)
    run.open()
    run.connect()
    run.poll_for(0.1)
    distance = np.abs(run.reading.positions - before)
    ran = bool((distance > np.abs(velocities) * (took + 0.25 + run.braking)).any())
    still = run.rest(0.3).good is True and not ran
    text = f"{text} ({took:.2f} s); {'all axes rest' if still else 'an axis continued to move'}"
    return Finding(Must.EMERGENCY_STOP, confirmed and still, text)


class _Run:
    """Stages that are polled and commanded as in the control loop."""

    def __init__(
        self, opens: Callable[[], Stages], joints: Sequence[JointFile], clock: Clock, stop: EmergencyStop | None
    ) -> None:
        self._opens, self.joints, self.clock, self.emergency_stop = opens, joints, clock, stop
        self.calls = Calls(clock)
        self.speeds = np.array([joint.speed for joint in joints])
        self.accelerations = np.array([joint.acceleration for joint in joints])
        self.braking = float((self.speeds / self.accelerations).max())  #: longest braking time [s]
        self._steps = np.array([joint.microstep for joint in joints])
        self._opened, self.reading = False, JointReading(np.nan * self.speeds, 0.0 * self.speeds)

    @property
    def now(self) -> float:
        """Time [s]."""
        return self.clock.now()

    @property
    def cause(self) -> str:
        """Text of the present fault."""
        return str(self.stages.trouble(self.now) or "no cause reported")

    def open(self) -> None:
        """Open the device and poll it once."""
        try:
            device = self._opens()
        except Exception as error:  # a foreign function can raise anything
            raise Broken(Must.CONNECTION, f"the device cannot be opened: {type(error).__name__}: {error}") from error
        self.stages: Stages = self.calls.guarded(device, partial(joint_reading, joints=len(self.joints)))
        self._opened, self._used = True, False
        self.read_at = self.now
        self.reading = self.stages.poll(self.read_at)

    def end(self) -> None:
        """Stop the stages and close them; if the driver fails, use its emergency stop."""
        try:
            if self._opened:
                self._used = False
                self.stages.stop(self.now)
                self.poll_for(0.2)  # if the line is busy, the driver sends the stop at a later poll
        except (Broken, DriverError):
            self.close()  # the emergency stop opens the port itself
            if self.emergency_stop is not None:
                with suppress(Exception, SystemExit):
                    self.emergency_stop(self.clock)
            raise
        finally:
            if self._opened:
                self.close()
            self.calls.close()

    def close(self) -> None:
        """Close the stages without stopping them."""
        self._opened = False
        self.stages.close()

    def connect(self) -> float:
        """Connect the stages; return the time that it took [s]."""
        start = self.now
        self.stages.connect(start)
        self.poll_for(CONNECT_S, until=lambda: self.stages.condition is not Condition.CONNECTING)
        took = self.now - start
        if self.stages.condition is not Condition.CONNECTED:
            raise Broken(Must.CONNECTION, f"{self.stages.condition.value} after {took:.1f} s: {self.cause}")
        self._used = True
        return took

    def home(self) -> Finding:
        """Home the stages unless they are ready."""
        if self.stages.ready:
            return Finding(Must.HOMING, True, "the stages are ready without homing")
        start, self._used = self.now, False  # the homing sets positions, so they may jump
        try:
            self.stages.home(start)
        except (Broken, DriverError):
            raise
        except CtrError as error:
            raise Broken(Must.HOMING, f"`home` refuses although the stages are not ready: {error}") from error
        self.poll_for(HOME_S, until=lambda: self.stages.condition is not Condition.HOMING)
        if not self.stages.ready:
            raise Broken(Must.HOMING, f"not homed after {self.now - start:.0f} s: {self.cause}")
        self._used = True
        return Finding(Must.HOMING, True, f"homed after {self.now - start:.0f} s")

    def obeys_command(self) -> bool:
        """Command a small velocity for a few ticks; return whether the driver sends it."""
        sent = False
        for _ in range(10):
            self.poll_for(0.001, 0.01 * self.speeds)
            sent = sent or bool(self.reading.sent.any())
        if sent:
            self.stages.stop(self.now)
        return sent

    def motion(self, share: float) -> tuple[Array, float]:
        """Return velocities toward the middle of each joint's travel, and how long they may last [s].

        The first joint has `share` of its largest speed. The others have other shares, so exchanged joints are noticed.
        """
        lower, upper = (np.array([getattr(joint, end) for joint in self.joints]) for end in ("lower", "upper"))
        slower = np.linspace(1.0, 0.7, len(self.joints)) if share < 1.0 else 1.0
        speeds = share * slower * self.speeds
        velocities = np.where(self.reading.positions < 0.5 * (lower + upper), speeds, -speeds)
        return velocities, min(RUN_S, float((TRAVEL * (upper - lower) / speeds).min()))

    def speeds_since(self, since: float) -> Array:
        """Return the speed of each joint since a time of at most half a second ago.

        It is the median slope of all pairs of positions, because a busy computer reads some positions late.
        """
        times, positions = zip(*(one for one in self._seen if one[0] >= since), strict=True)
        return np.array([theilslopes(one, times)[0] for one in np.transpose(positions)])

    def rest(self, seconds: float) -> Finding:
        """Return the finding whether all axes are at rest for `seconds`."""
        before = self.reading.positions
        self.poll_for(seconds)
        moved = self._moved(before)
        text = f"the positions change by {moved:.1f} microsteps in {seconds:g} s; sent {self.reading.sent}"
        return Finding(Must.REST, not moved > STILL and not self.reading.sent.any(), text)

    def stop(self) -> None:
        """Stop the stages and wait until they rest."""
        self.stages.stop(self.now)
        self._time_to_rest(2.0 + self.braking)

    def stopped(self, requirement: Must, velocities: Array) -> Finding:
        """Return the finding whether the axes stop in time, then move them with `velocities` for a moment.

        The motion must start at the position of rest. If a position jumps, the driver reported an old one before.
        """
        rest = self._time_to_rest(2.0 + self.braking)
        good = rest <= MAX_STOP_S + self.braking and not self.reading.sent.any()
        if good:
            before, start = self.reading.positions, self.now
            self.poll_for(1.2 * FROZEN_S, velocities)
            excess = np.abs(self.reading.positions - before) - 1.1 * np.abs(velocities) * (self.now - start)
            self.stop()
            if (excess > STILL * self._steps).any():
                raise Broken(Must.FRESH, "a position has jumped: the positions before the jump were old")
        return Finding(requirement, good, f"at rest after {1e3 * rest:.0f} ms; `sent` was {self.reading.sent}")

    def poll_for(
        self, seconds: float, velocities: Array | None = None, until: Callable[[], bool] = lambda: False
    ) -> None:
        """Poll and command the stages for `seconds`, or until `until` returns true."""
        start = self.now
        while (now := self.now) - start < seconds and not until():
            last = self.reading.positions
            self.reading, self.read_at = self.stages.poll(now), now
            fault = self.stages.trouble(now)
            if self._used:
                self._watch(last, fault)
            else:
                self._seen, self._since, self._same = deque(), np.full(len(self.joints), now), 0 * self._steps
            if velocities is not None:
                self.stages.command(velocities, now)
            self.calls.end_tick()

    def _watch(self, last: Array, fault: DeviceFault | None) -> None:
        """Check that the stages remain connected, and that their positions are plausible."""
        positions, sent, now = self.reading.positions, self.reading.sent, self.read_at
        if self.stages.condition is not Condition.CONNECTED:
            text = f"the state changed to {self.stages.condition.value}: {fault or 'no cause reported'}"
            raise Broken(Must.CONNECTION, text)
        if not np.isfinite(positions[np.isfinite(last)]).all():
            raise Broken(Must.FINITE, f"the positions were {last} and became {positions}")
        idle = (positions != last) | (np.abs(sent) * FROZEN_S < 10.0 * self._steps)
        self._since, self._same = np.where(idle, now, self._since), np.where(idle, 0, self._same + 1)
        for i in np.flatnonzero((now - self._since > FROZEN_S) & (self._same > FROZEN_POLLS)).tolist():
            raise Broken(Must.FRESH, f"{self.joints[i].name} stays at {positions[i]:.6g}; `sent` is {sent[i]:.3g}")
        self._seen.append((now, positions))
        while now - self._seen[0][0] > 1.5 * TOO_FAST_S:
            self._seen.popleft()
        since, before = self._seen[0]
        if now - since >= TOO_FAST_S:
            speeds = np.abs(positions - before) / (now - since)
            for i in np.flatnonzero(speeds > TOO_FAST * self.speeds + STILL * self._steps / TOO_FAST_S).tolist():
                text = f"{self.joints[i].name} moves at {speeds[i]:.3g}; its largest speed is {self.speeds[i]:.3g}"
                raise Broken(Must.SPEED_LIMIT, text)

    def _time_to_rest(self, seconds: float) -> float:
        """Return the time until the positions no longer change [s]; infinite if they change for `seconds`."""
        start = since = self.now
        last = self.reading.positions
        while since - start < seconds:
            self.poll_for(0.01)
            if (np.abs(self.reading.positions - last) > 2.0 * self._steps).any():
                since, last = self.now, self.reading.positions
            elif self.now - since > 0.2:
                return since - start
        return math.inf

    def _moved(self, before: Array) -> float:
        """Return the largest change of a position [microsteps]; NaN: no position is known."""
        return float((np.abs(self.reading.positions - before) / self._steps).max())
