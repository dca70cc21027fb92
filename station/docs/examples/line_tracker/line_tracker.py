"""Example of a custom driver: a tracker that sends a line `frame x y z` [mm] by TCP for every measured frame."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from station.config.robots import RobotFile
from station.config.strict import Positive, Strict, check
from station.devices.config import Mount
from station.devices.interfaces import Condition, DeviceFault, Severity, TipReading
from station.devices.kernel.sampled import SampleClock
from station.devices.links.link import LinkError, SerialLink, reopen


class Options(Strict):
    """Keys of `[devices.tracker]` in the station file."""

    host: str
    port: int
    rate: Positive = 40.0  # measured frames per second
    latency: float = 0.0  # shortest time from a measurement to the arrival of its line [s]
    mount: Mount = Mount()  # pose of the tracker in the world frame


class LineTracker:
    """Driver of the tracker. The control loop polls it, so it never waits, and after `connect` it never raises."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._link = SerialLink(f"socket://{options.host}:{options.port}", 9600)  # raises LinkError
        # A line can be late, but never early: the clock finds the time of a frame from its number.
        self._clock = SampleClock(options.rate, drift=5e-4, latency=options.latency)
        self._received, self._problem, self._newest, self._malformed = b"", "", -np.inf, 0

    @property
    def condition(self) -> Condition:
        if self._problem:
            return Condition.FAULT
        return Condition.CONNECTED if np.isfinite(self._newest) else Condition.CONNECTING

    def connect(self, now: float) -> None:
        if self._problem:
            try:
                reopen(self._link)
                self._clock.restart()
                self._problem = ""
            except LinkError as error:
                self._problem = str(error)

    def poll(self, now: float) -> TipReading | None:
        if self._problem:
            return None
        try:
            self._received += self._link.read()
        except LinkError as error:
            self._problem = str(error)
        *lines, self._received = self._received.split(b"\n")
        for line in reversed(lines):
            try:
                number, *position = line.split()
                frame, (x, y, z) = int(number), map(float, position)
                if not np.isfinite([x, y, z]).all():
                    raise ValueError
            except ValueError:
                self._malformed += 1
                continue
            time = self._clock.measured(frame, now)  # None: the frame number is impossible
            if time is not None:
                self._newest = now
                mount = self._options.mount
                world = mount.rotation @ (1e-3 * np.array([x, y, z])) + mount.position
                return TipReading(frame, time, world)
        return None

    def trouble(self, now: float) -> DeviceFault | None:
        if self._problem or now - self._newest > 10.0 / self._options.rate:
            text = "the tracker sends no frames; is it tracking?"
            return DeviceFault(Severity.HOLD, text, self._problem or self._link.name)
        return None

    def details(self) -> Mapping[str, Any]:
        return {"port": self._link.name, "malformed_lines": self._malformed}

    def close(self) -> None:
        self._link.close()


def open_tracker(options: Mapping[str, Any], robot: RobotFile) -> LineTracker:
    """Entry point of the driver: open the tracker."""
    return LineTracker(check(Options, options, "devices.tracker"))
