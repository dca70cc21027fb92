"""An Aurora as the control loop's tracker: a session on a link, looked at once a tick."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.aurora.dialogue import Break, Rate
from station.devices.aurora.measurement import Counts, Measurement, Quality
from station.devices.aurora.replies import ToolIdentity
from station.devices.aurora.session import AuroraSession
from station.devices.aurora.settings import AuroraSettings
from station.devices.interfaces import Condition, Severity, TipReading, Trouble
from station.devices.links.link import Link, LinkError

#: Without a new frame for this long the tracker is silent: four frames [s].
SILENCE = 0.1
#: Without a good position for this long nothing may move [s].
BLIND = 0.25


@dataclass(frozen=True)
class Registration:
    """Where the field generator stands in the world: p_world = rotation @ p_tracker + position."""

    rotation: Array = field(default_factory=lambda: np.eye(3))  #: (3, 3)
    position: Array = field(default_factory=lambda: np.zeros(3))  #: (3,) [m]

    def world(self, millimetres: tuple[float, ...]) -> Array:
        """A tracker position [mm] in the world (3,) [m]."""
        return self.rotation @ (1e-3 * np.array(millimetres)) + self.position


class TrackerReport(NamedTuple):
    """How the tracker is doing, for whoever decides to hold."""

    quality: Quality
    good_age: float  #: since the last good position was measured; infinite before the first [s]
    trouble: str  #: in words; empty when there is none
    firmware: str  #: the unit's freeze tag
    tool: ToolIdentity | None  #: the coil at the tip
    counts: Counts
    noise: int  #: bytes that belonged to no reply
    crc_errors: int


class AuroraTracker:
    """Driver of one Aurora; implements `Tracker`. Nothing that the bytes do raises out of `poll`."""

    def __init__(
        self,
        link: Link,
        settings: AuroraSettings | None = None,
        registration: Registration | None = None,
        reopen: Callable[[Link], Link] | None = None,
    ) -> None:
        """`reopen` opens a link anew that has gone; it raises LinkError where it cannot."""
        self._reopen = reopen
        self._link = link
        self._settings = settings or AuroraSettings()
        self._registration = registration or Registration()
        self._session = AuroraSession(self._settings)
        self._lost = ""
        self._good_time = self._target_time = -math.inf

    @property
    def condition(self) -> Condition:
        """CONNECTED once it has tracked: what is amiss since then is `trouble`."""
        if self._lost:
            return Condition.FAULT
        return Condition.CONNECTED if self._good_time > -math.inf else Condition.CONNECTING

    def connect(self, now: float) -> None:  # noqa: ARG002 - the session connects by itself when it is polled
        """Try again on a link that had gone; a session that goes on is left alone."""
        if self._lost and self._reopen is not None:
            try:
                self.attach(self._reopen(self._link))
            except LinkError as error:
                self._lost = str(error)

    def trouble(self, now: float) -> Trouble | None:
        """No good position: a warning, after 0.25 s a HOLD, with the reason."""
        if now - self._good_time <= SILENCE and not self._lost:
            return self._target_trouble(now)
        report = self.report(now)
        severity = Severity.HOLD if self._lost or report.good_age > BLIND else Severity.WARN
        # The newest is good and yet old: the unit or this computer was held up.
        what = "late" if report.quality is Quality.GOOD else report.quality.name.lower().replace("_", " ")
        since = "" if math.isinf(report.good_age) else f"; no good position for {report.good_age:.2f} s"
        return Trouble(severity, f"tracker ({self._link.name}): {what}{since}{report.trouble and '; '}{report.trouble}")

    def _target_trouble(self, now: float) -> Trouble | None:
        """No good position of the target that was asked for: a warning."""
        serial, age = self._settings.target_serial, now - self._target_time
        if not serial or age <= SILENCE:
            return None
        what = self._session.target_quality.name.lower().replace("_", " ")
        if self._session.talk.target is None:
            what = f"not plugged in; tools that are: {', '.join(t.serial for t in self._session.talk.tools.values())}"
        since = "" if math.isinf(age) else f"; no good position for {age:.2f} s"
        return Trouble(Severity.WARN, f"tracker ({self._link.name}): target {serial}: {what}{since}")

    def details(self) -> Mapping[str, Any]:
        """Who it is and what it has counted."""
        report = self.report(self._session.talk.now)
        return {
            "port": self._link.name,
            "firmware": report.firmware,
            "tool": None if report.tool is None else report.tool._asdict(),
            **({"target": self._session.talk.target is not None} if self._settings.target_serial else {}),
            **vars(report.counts),
            "noise_bytes": report.noise,
            "crc_errors": report.crc_errors,
        }

    def poll(self, now: float) -> TipReading | None:
        """The newest good frame that arrived since the last poll, if any."""
        if self._lost:
            return None
        measurements: list[Measurement] = []
        try:
            data = self._link.read()
            if not data and now < self._session.wake:
                return None
            measurements = self._session.receive(data, now)
            for order in self._session.due(now):
                self._carry_out(order)
        except LinkError as error:
            self._lost = str(error)
        newest = next((m for m in reversed(measurements) if m.position is not None), None)
        if newest is None or newest.position is None:
            return None
        self._good_time = newest.time
        target = None
        if newest.target is not None:
            target, self._target_time = self._registration.world(newest.target), newest.time
        axis = newest.axis if self._settings.tells_axis else None
        direction = None if axis is None else self._registration.rotation @ np.array(axis)
        return TipReading(newest.frame, newest.time, self._registration.world(newest.position), target, direction)

    def report(self, now: float) -> TrackerReport:
        """How it stands at `now` [s]."""
        session = self._session
        quality, trouble = session.quality, session.talk.trouble
        if self._lost:
            quality, trouble = Quality.LOST, self._lost
        elif session.tracking and now - session.last_arrival > SILENCE:
            quality = Quality.SILENT
            trouble = trouble or f"no new frame for {now - session.last_arrival:.2f} s"
        tool = None if session.talk.handle is None else session.talk.tools.get(session.talk.handle)
        return TrackerReport(
            quality,
            now - self._good_time,
            trouble,
            session.talk.firmware,
            tool,
            replace(session.counts),
            session.reader.noise,
            session.reader.crc_errors,
        )

    def attach(self, link: Link) -> None:
        """Begin anew on another link after the first was lost; only the same coil is taken again."""
        report = self.report(0.0)
        if report.tool is not None:
            self._settings = replace(self._settings, tool_serial=report.tool.serial)
        self._link, self._lost = link, ""
        self._good_time = self._target_time = -math.inf
        self._session = AuroraSession(self._settings)

    def close(self) -> None:
        """Tell the unit to stop tracking and let go of the port."""
        try:
            for order in self._session.farewell():
                self._carry_out(order)
        except LinkError as error:
            self._lost = str(error)
        self._link.close()

    def _carry_out(self, order: bytes | Rate | Break) -> None:
        """A pipe in memory has neither rate nor break; a pty and a socket take both and ignore the break."""
        if isinstance(order, bytes):
            self._link.write(order)
        elif isinstance(order, Rate):
            set_baud = getattr(self._link, "set_baud", None)
            if set_baud is not None:
                set_baud(order.baud)
        else:
            set_break = getattr(self._link, "set_break", None)
            if set_break is not None:
                set_break(order.low)
