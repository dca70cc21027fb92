"""Driver of an Aurora tracker for the control loop: a session on a link, polled once per tick."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from core.calibration.rigid_transform import RigidTransform
from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import MAX_SILENCE_S, ConfigError, Latency, Strict, check
from station.devices.aurora.dialogue import ANY_COIL, AuroraSettings, Coil, RateChange, SerialBreak
from station.devices.aurora.protocol import POWER_UP_BAUD, ToolIdentity
from station.devices.aurora.session import MAX_UNREADABLE_BYTES, AuroraSession, TrackerFrame
from station.devices.config import Mount, Serial
from station.devices.interfaces import Condition, DeviceFault, Severity, TipReading
from station.devices.kernel.quality import Quality, Sampled, quoted, sample_fault
from station.devices.links.link import Link, LinkError, SerialLink, reopen

#: The tracker counts as silent after this time without a new frame [s]: the duration of four frames.
SILENCE_TIMEOUT_S = 0.1
#: A motion ends in the state HOLD after this time without a good position, unless `stale_after` is set [s].
HOLD_AFTER_S = 0.25
#: Lasting additional delay of the frames that is reported [s], and its warning.
LATE_S = 0.02
LATE = (
    "the tracker's frames arrive {:.0f} ms later than at first, so that their times may be wrong: check what delays"
    " them (cable, hub, other programs), or calibrate the latency"
)


#: Pose of the field generator in the world: p_world = rotation @ p_tracker + position.
TrackerMounting = RigidTransform


class TrackerReport(NamedTuple):
    """State of the tracker, from which the driver determines its fault."""

    quality: Quality
    good_age: float  #: time since the last good position was measured; infinite before the first one [s]
    trouble: str  #: human-readable reason of a problem; empty if there is none


class AuroraTracker:
    """Driver of one Aurora; implements `Tracker`. `poll` never raises, whatever bytes arrive."""

    def __init__(
        self, link: Link, settings: AuroraSettings | None = None, registration: TrackerMounting | None = None,
        stale_after: float = HOLD_AFTER_S,
    ) -> None:  # fmt: skip
        """`stale_after`: time without a good position that is a HOLD [s]."""
        self._link = link
        self._settings, self._stale_after = settings or AuroraSettings(), stale_after
        self._registration = registration or TrackerMounting(np.eye(3), np.zeros(3))
        self._session = AuroraSession(self._settings)
        self._lost = ""
        self._good_time = self._target_time = -math.inf

    @property
    def condition(self) -> Condition:
        """CONNECTED after the first good frame; `trouble` reports later faults."""
        if self._lost:
            return Condition.FAULT
        return Condition.CONNECTED if self._good_time > -math.inf else Condition.CONNECTING

    def connect(self, now: float) -> None:  # noqa: ARG002 - the session connects by itself when it is polled
        """Open a lost link again; a running session continues unchanged."""
        if self._lost:
            try:
                self.attach(reopen(self._link))
            except LinkError as error:
                self._lost = str(error)

    def trouble(self, now: float) -> DeviceFault | None:
        """Return WARN after 0.1 s without a position or if frames are late, HOLD after `stale_after` or a lost port."""
        rate = self._session.clock.wrong_rate
        if now - self._good_time <= SILENCE_TIMEOUT_S and not self._lost and rate is None:
            if (late := self._session.clock.shift) > LATE_S:
                return DeviceFault(Severity.WARN, LATE.format(1e3 * late), f"tracker on {self._link.name}")
            return None if self._settings.target is None else self._target_trouble(now, self._settings.target)
        quality, age, trouble = self.report(now)
        because = ""
        if quality is Quality.CONNECTING and trouble:
            because = f"cannot start: {trouble}"
        elif quality is Quality.WRONG_RATE:
            because = (
                f"measures about {rate:.3g} frames/s, and 'frame_rate' is {self._settings.frame_rate:g}: set"
                " 'frame_rate' to the rate of this unit"
            )
        elif quality is Quality.UNREADABLE:
            because = f"sends {quoted(self._session.dialogue.unreadable)}, which is no frame{{since}}: check the cable"
        details = f"tracker on {self._link.name}: {', '.join(quality.words or ['late'])}{trouble and ', '}{trouble}"
        return sample_fault([Sampled("the tracker", quality, age, details, because)], self._stale_after)

    def _target_trouble(self, now: float, target: Coil) -> DeviceFault | None:
        """Return a warning if the configured target has no good position."""
        age = now - self._target_time
        if age <= SILENCE_TIMEOUT_S:
            return None
        what = " ".join(self._session.target_quality.words)
        if self._session.dialogue.target is None:
            what = f"not plugged in; connected tools: {self._session.dialogue.connected}"
        since = "" if math.isinf(age) else f"; no good position for {age:.2f} s"
        text = f"the tracker does not measure the target {target}: {what}{since}"
        return DeviceFault(Severity.WARN, text, f"tracker on {self._link.name}")

    def details(self) -> Mapping[str, Any]:
        """Return identity and counters of the tracker."""
        session = self._session
        return {
            "port": self._link.name,
            "firmware": session.dialogue.firmware,
            "tool": None if self._tool is None else self._tool._asdict(),
            **({"target": session.dialogue.target is not None} if self._settings.target else {}),
            **vars(session.counts),
            "noise_bytes": session.reader.noise,
            "crc_errors": session.reader.crc_errors,
        }

    @property
    def _tool(self) -> ToolIdentity | None:
        """Identity of the coil at the tip; None before the unit has reported it."""
        dialogue = self._session.dialogue
        return None if dialogue.handle is None else dialogue.tools.get(dialogue.handle)

    def poll(self, now: float) -> TipReading | None:
        """Return the newest good frame that arrived since the last poll, or None."""
        if self._lost:
            return None
        measurements: list[TrackerFrame] = []
        try:
            data = self._link.read()
            if not data and now < self._session.wake:
                return None
            measurements = self._session.receive(data, now)
            for order in self._session.due(now):
                self._carry_out(order)
        except LinkError as error:
            self._lost = str(error)
        if not measurements:
            return None
        newest = next((m for m in reversed(measurements) if m.position is not None), None)
        if newest is None or newest.position is None:
            return None
        self._good_time = newest.time
        target = None
        if newest.target is not None:
            target, self._target_time = self._world(newest.target), newest.time
        axis = newest.axis if self._settings.measures_axis else None
        direction = None if axis is None else self._registration.rotation @ np.array(axis)
        return TipReading(newest.frame, newest.time, self._world(newest.position), target, direction)

    def _world(self, millimetres: tuple[float, ...]) -> Array:
        """Convert a tracker position [mm] to the world frame (3,) [m]."""
        return self._registration.rotation @ (1e-3 * np.array(millimetres)) + self._registration.position

    def report(self, now: float) -> TrackerReport:
        """Return the state of the tracker at `now` [s]."""
        session = self._session
        quality, trouble = session.quality, session.dialogue.trouble
        silent = now - session.last_arrival
        if self._lost:
            quality, trouble = Quality.LOST, self._lost
        elif (
            session.tracking
            and session.clock.wrong_rate is not None
            and (quality.is_usable or silent > SILENCE_TIMEOUT_S)
        ):
            quality = Quality.WRONG_RATE
        elif session.tracking and silent > SILENCE_TIMEOUT_S:
            quality = Quality.UNREADABLE if len(session.dialogue.unreadable) == MAX_UNREADABLE_BYTES else Quality.SILENT
            trouble = trouble or f"no new frame for {silent:.2f} s"
        return TrackerReport(quality, now - self._good_time, trouble)

    def attach(self, link: Link) -> None:
        """Start a new session on another link after a loss; the session accepts only the same coil at the tip."""
        if self._tool is not None and not self._settings.tool.serial:
            self._settings = replace(self._settings, tool=self._settings.tool._replace(serial=self._tool.serial))
        self._link, self._lost = link, ""
        self._good_time = self._target_time = -math.inf
        self._session = AuroraSession(self._settings)

    def close(self) -> None:
        """Command the unit to stop tracking and close the port."""
        try:
            for order in self._session.farewell():
                self._carry_out(order)
        except LinkError as error:
            self._lost = str(error)
        self._link.close()

    def _carry_out(self, order: bytes | RateChange | SerialBreak) -> None:
        """Execute a command to the port; a link that has no baud rate or no break ignores the command to change it."""
        if isinstance(order, bytes):
            self._link.write(order)
        elif isinstance(order, RateChange):
            set_baud = getattr(self._link, "set_baud", None)
            if set_baud is not None:
                set_baud(order.baud)
        else:
            set_break = getattr(self._link, "set_break", None)
            if set_break is not None:
                set_break(order.low)


PortNumber = Annotated[int, Field(ge=1, le=255)]
Channel = Annotated[int, Field(ge=0, le=255)]


class AuroraFile(Strict):
    """NDI Aurora tracker."""

    port: Serial
    """serial port of the tracker"""
    tool: str = ""
    """serial number of the coil at the tip, as the tracker reports it; "": any"""
    tool_port: PortNumber | None = None
    """number of the tracker's port into which the coil at the tip is plugged; default: any"""
    tool_channel: Channel | None = None
    """channel of the coil at the tip, 0 or 1: two coils in one plug have the same serial number; default: any"""
    target: str = ""
    """serial number of a second coil, on the target of the motion `follow`; "": any if `target_port` or
    `target_channel` is set, else no second coil"""
    target_port: PortNumber | None = None
    """number of the port of the target's coil; default: any"""
    target_channel: Channel | None = None
    """channel of the target's coil; default: any"""
    baud: int = AuroraSettings.baud
    """baud rate to which the driver switches; the tracker must support this rate [bit/s]"""
    frame_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = AuroraSettings.frame_rate
    """number of frames that the tracker measures per second [1/s]"""
    latency: Latency = AuroraSettings.latency
    """shortest time from a measurement to the arrival of the reply with this measurement at 115200 baud [s]"""
    always_tx: bool = False
    """request frames as text (TX), for very old firmware"""
    stale_after: Annotated[float, Field(ge=SILENCE_TIMEOUT_S, le=MAX_SILENCE_S)] = HOLD_AFTER_S
    """time without a good position after which a motion ends in HOLD; meanwhile only the model knows the tip [s]"""
    fault_bits: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """port status bits that invalidate a measurement, in addition to the two out-of-volume bits"""
    mount: Mount = Mount()
    """pose of the field generator in the world, from a registration"""
    coil_to_tip: float = 0.0
    """distance from the coil to the robot's tip along the coil's axis, any number [m]"""


def aurora(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], AuroraTracker]:  # noqa: ARG001
    """Check the options, and return the function that opens an NDI Aurora; raises ConfigError."""
    key = "devices.tracker"
    file = check(AuroraFile, options, key)
    target = Coil(file.target, file.target_port, file.target_channel)
    try:
        settings = AuroraSettings(
            tool=Coil(file.tool, file.tool_port, file.tool_channel),
            target=None if target == ANY_COIL else target,
            baud=file.baud,
            frame_rate=file.frame_rate,
            latency=file.latency,
            always_tx=file.always_tx,
            coil_to_tip=1e3 * file.coil_to_tip,
            fault_bits=file.fault_bits,
        )
    except CtrError as error:
        wrong = f"target = '{file.target}'" if "the target's" in str(error) else f"baud = {file.baud}"
        raise ConfigError(f"{key}.{wrong}: {error}") from None
    registration = TrackerMounting(file.mount.rotation, np.array(file.mount.position))
    return lambda: AuroraTracker(SerialLink(file.port, POWER_UP_BAUD), settings, registration, file.stale_after)
