"""Every tracker driver with its simulated device, in virtual time: the same few methods for all of them."""

from collections.abc import Callable
from typing import Protocol

import pytest

from core.robot.robot import Array
from station.config.robots import load_robot
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.interfaces import TipReading, Tracker
from station.devices.links.link import LinkError
from station.devices.stereo.tracker import StereoTracker
from station.docs.examples.line_tracker import line_tracker
from station.lab.wires import HostPort, MemoryInbox, SerialDeviceEnd
from tests.harness.aurora_bench import REST, AuroraBench
from tests.harness.stereo_rig import CAMERAS, Rig

#: A reading of the driver with the time of the poll that returned it [s].
Readings = list[tuple[float, TipReading]]
Path = Callable[[float], Array]
TICK = 0.002


def at_rest(_: float) -> Array:
    return REST


class TrackerBench(Protocol):
    """A tracker driver and its simulated device."""

    tracker: Tracker
    now: float
    name: str  #: part of the device's name in every fault
    bound: float  #: longest time from the last good measurement to a HOLD [s]
    gated: bool  #: whether the driver rejects positions that jump

    def run(self, seconds: float, tip: Path = at_rest) -> Readings:
        """Poll the driver while the tip moves along `tip`."""
        ...

    def hide(self, hidden: bool) -> None:
        """Make the tip invisible for the device, or visible again."""
        ...

    def freeze(self, frozen: bool) -> None:
        """Make the device repeat its last frame."""
        ...

    def cut(self) -> None:
        """Cut the line."""
        ...

    def mend(self) -> None:
        """Repair the line."""
        ...

    def feed(self, data: bytes) -> None:
        """Send bytes to the driver that no device sends."""
        ...


class AuroraTrackerBench:
    """An NDI Aurora."""

    name, bound, gated = "aurora", 0.25, True

    def __init__(self, settings: AuroraSettings | None = None, end: SerialDeviceEnd | None = None) -> None:
        self._bench = AuroraBench(settings)
        self._bench.port.device = end or self._bench.port.device
        self.tracker = self._bench.tracker

    @property
    def now(self) -> float:
        return self._bench.now

    def run(self, seconds: float, tip: Path = at_rest) -> Readings:
        return self._bench.run(seconds, tip)

    def hide(self, hidden: bool) -> None:
        self._bench.unit.faults.tool_lost = hidden

    def freeze(self, frozen: bool) -> None:
        self._bench.unit.faults.freeze = frozen

    def cut(self) -> None:
        self._bench.port.device.unplug()

    def mend(self) -> None:
        self._bench.port.device.plug()

    def feed(self, data: bytes) -> None:
        self._bench.port.device.write(data)


class _FaultyInbox(MemoryInbox):
    """Receiver of datagrams that can fail, and repeat the last datagram."""

    cut = frozen = False
    _last: list[bytes] = []

    def receive(self) -> list[bytes]:
        if self.cut:
            raise LinkError("the port of the cameras is gone")
        received = super().receive()
        if not self.frozen:
            self._last = received[-1:] or self._last
            return received
        return self._last


class StereoBench:
    """Two cameras."""

    name, bound, gated = "camera", 0.34, True

    def __init__(self, inbox: MemoryInbox | None = None) -> None:
        self._rig = Rig(at_rest)
        self._rig.inbox = self._inbox = inbox or _FaultyInbox()
        self._rig.tracker = self.tracker = StereoTracker(self._inbox, CAMERAS)
        self._hidden = False
        self._rig.hidden = lambda name, time: self._hidden
        self.now = 0.0

    def run(self, seconds: float, tip: Path = at_rest) -> Readings:
        self._rig.path = tip
        start, self.now = self.now, round(self.now + seconds, 9)
        self._rig.times.clear()
        readings = self._rig.run(self.now, start)
        return list(zip(self._rig.times, readings, strict=True))

    def hide(self, hidden: bool) -> None:
        self._hidden = hidden

    def freeze(self, frozen: bool) -> None:
        self._inbox.frozen = frozen

    def cut(self) -> None:
        self._inbox.cut = True

    def mend(self) -> None:
        self._inbox.cut = False

    def feed(self, data: bytes) -> None:
        self._inbox.put(data)


class LineBench:
    """The tracker of the example package: it sends a line for each frame, 40 a second."""

    name, bound, gated = "line", 0.25, False
    PERIOD_S = 0.025

    def __init__(self) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(line_tracker, "SerialLink", lambda url, baud: self._open(url))
            self.tracker = line_tracker.open_tracker({"host": "line", "port": 1}, load_robot("paper"))
        self.now, self._frame, self._due = 0.0, 0, 0.0
        self._hidden = self._frozen = False

    def _open(self, url: str) -> HostPort:
        self._port = HostPort(url)
        return self._port

    def run(self, seconds: float, tip: Path = at_rest) -> Readings:
        readings: Readings = []
        for _ in range(round(seconds / TICK)):
            self.now = round(self.now + TICK, 9)
            if self.now >= self._due:
                self._due += self.PERIOD_S
                self._frame += not self._frozen
                x, y, z = (1e3 * tip(self.now)).tolist()
                if not self._hidden:
                    self._port.device.write(f"{self._frame} {x} {y} {z}\n".encode())
            if (reading := self.tracker.poll(self.now)) is not None:
                readings.append((self.now, reading))
        return readings

    def hide(self, hidden: bool) -> None:
        self._hidden = hidden

    def freeze(self, frozen: bool) -> None:
        self._frozen = frozen

    def cut(self) -> None:
        self._port.device.unplug()

    def mend(self) -> None:
        self._port.device.plug()

    def feed(self, data: bytes) -> None:
        self._port.device.write(data)


BENCHES: dict[str, Callable[[], TrackerBench]] = {
    "aurora": AuroraTrackerBench,
    "stereo": StereoBench,
    "line-tracker": LineBench,
}
