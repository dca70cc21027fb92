"""Driver of base sensors with ATI Net F/T boxes, one per sensor, interpolated to a common time; without threads.

An invalid sample never replaces the last valid wrench of its sensor. `quality` reports the faults of the samples.
"""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag
from types import MappingProxyType
from typing import Annotated, Any, Protocol

import httpx
import numpy as np
from pydantic import Field

from core.compiled import compiled
from core.errors import CtrError
from core.robot.robot import Array, Indices
from station.config.robots import RobotFile
from station.config.strict import Name, NotNegative, Positive, Row, Strict, check
from station.devices.ati.calibration import MAX_PAGE_BYTES, NetftPage, read_page
from station.devices.ati.protocol import (
    LATENCY_S,
    RDT_PORT,
    SATURATED,
    THRESHOLD_LATCHED,
    Counters,
    RdtCommand,
    RdtSample,
    SampleClock,
    SampleHistory,
    SampleRing,
    Stream,
    describe,
    follow,
    is_usable,
    push,
    request,
)
from station.devices.config import Mount, TcpPort, in_order, mounted
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, Severity, WrenchReading
from station.devices.links.link import DatagramLink, LinkError


class SensorError(CtrError):
    """A force sensor cannot be reached or is not the expected one; the text names the sensor and what to do."""


class WrenchQuality(IntFlag):
    """Faults of a sensor's reading; 0: none."""

    GOOD = 0
    LATCHED = 1  #: a monitor condition has latched in the box; a warning
    GAP = 2  #: records were lost since the last poll; a warning
    STALE = 4  #: no usable sample for too long, or none yet
    SATURATED = 8  #: the transducer or its converter is saturated
    STATUS = 16  #: the box reports another fault
    RANGE = 32  #: the wrench is outside the calibration's range, although the box reports no fault
    RESET = 64  #: the box has restarted since the stream started: its bias and identity are unknown
    GONE = 128  #: the link is gone

    @property
    def is_usable(self) -> bool:
        """Whether the reading is valid for control."""
        return not self & ~(WrenchQuality.LATCHED | WrenchQuality.GAP)


#: What has happened to a sensor whose reading has a fault, the most specific fault first.
HAPPENED = MappingProxyType(
    {
        WrenchQuality.GONE: "is not connected",
        WrenchQuality.RESET: "has restarted, so its zero is unknown",
        WrenchQuality.SATURATED: "is saturated: take the load off",
        WrenchQuality.STATUS: "reports a fault",
        WrenchQuality.RANGE: "measures more than its calibration allows: take the load off",
        WrenchQuality.STALE: "was silent for too long",
    }
)
#: Silence after which the driver requests the stream again [s].
RETRY_AFTER_S = 0.5


class ForceBoxFile(Strict):
    """One ATI Net F/T box."""

    host: Annotated[str, Field(min_length=1)]
    """host name or IP address of the box"""
    rdt_port: TcpPort = RDT_PORT
    """UDP port of its datagrams"""
    http_port: TcpPort = 80
    """TCP port of its configuration page"""
    serial: str | None = None
    """serial number of the calibration that the box must report; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame in the frame at its tube's proximal end (x along alpha = 0, z along the tube)"""


class NetftSettings(Strict):
    """Settings of the driver."""

    stale_after: Positive = 0.05
    """time without a usable record after which a sensor counts as stale [s]"""
    latency: NotNegative = LATENCY_S
    """time from a measurement until the box sends its record [s]"""
    ranges: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], Row] = (
        18.0, 18.0, 18.0, 0.25, 0.25, 0.25,
    )  # fmt: skip
    """calibrated ranges of Fx Fy Fz Tx Ty Tz, used if the box's configuration page has none [N, N m]; default: those of
    a Nano43 SI-18-0.25"""


class NetftFile(NetftSettings):
    """ATI Net F/T boxes, one for each tube."""

    tubes: Mapping[Name, ForceBoxFile]
    """box of the sensor at each tube, by the name of the tube"""


class Datagrams(Protocol):
    """A link of whole datagrams to one box: UDP, or a queue in memory."""

    name: str  #: for messages

    def receive(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        ...

    def send(self, datagram: bytes) -> None:
        """Send one datagram, which may get lost."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


# Flags as plain integers, because operations on `IntFlag` are slow and every tick uses the flags.
_LATCHED, _GAP, _STALE, _SATURATED, _STATUS, _RANGE, _RESET, _GONE = (int(flag) for flag in WrenchQuality)


class _Sensor:
    """One box: its stream, its usable samples and its quality."""

    def __init__(self, link: Datagrams, page: NetftPage, settings: NetftSettings, good: SampleRing) -> None:
        self.link = link
        self.page = page
        self.stream = Stream(settings.latency)
        self.good = good
        self.flags = _STALE
        self.status = 0
        self.requests = 0
        self._settings = settings
        scale = [page.force_count] * 3 + [page.torque_count] * 3
        self._limits = np.array(page.ranges or settings.ranges) / scale
        self._last_received = self._last_usable = 0.0
        self._streaming = False
        self._latched_flags = 0  # flags that stay until the operator starts the stream again
        self._newest = 0  # flags of the newest records

    def warm_up(self) -> None:
        """Load the compiled code now, because the first call takes longer than a tick."""
        SampleClock().observe(0, SampleClock().latest(0.0))
        good = self.good
        _kept(*self.stream.state, b"", 0.0, self._limits, good.row, good.rows, good.ends, good.time)
        self.good.push()
        self.good.clear()

    def start(self, now: float) -> None:
        """Start a stream and clear all flags."""
        self._latched_flags = self._newest = 0
        self.flags = _STALE
        self.stream = Stream(self._settings.latency, now)
        self.good.clear()
        self._streaming = True
        self._last_received = self._last_usable = now
        self._request_stream()

    def stop(self) -> None:
        self._streaming = False
        self.send(RdtCommand.STOP)

    def send(self, command: RdtCommand) -> None:
        self.link.send(request(command))

    def poll(self, now: float) -> bool:
        """Process the datagrams that have arrived and return whether there were any; never raises."""
        stream, good, flags, newest, received = self.stream, self.good, 0, 0, False
        try:
            for datagram in self.link.receive():
                newest_time = _kept(
                    *stream.state, datagram, now, self._limits, good.row, good.rows, good.ends, good.time
                )
                if newest_time > -math.inf:
                    good.time, self.status, self._last_usable, received = newest_time, 0, now, True
                    continue
                counters = stream.counters
                lost, resets = counters.lost, counters.resets
                for sample in stream.feed(datagram, now):
                    newest |= self._take(sample, now)
                    received = True
                flags |= (_GAP if counters.lost > lost else 0) | (_RESET if counters.resets > resets else 0)
            if received:
                self._last_received, self._newest = now, newest
            elif self._streaming and now - self._last_received >= RETRY_AFTER_S:
                self._last_received = now
                stream.restart()
                self._request_stream()
        except LinkError:
            flags |= _GONE
        if flags & _RESET:
            self._latched_flags |= _RESET
            good.clear()
        flags |= self._newest | self._latched_flags
        if good.time == -math.inf or now - self._last_usable > self._settings.stale_after:
            flags |= _STALE
        self.flags = flags
        return received

    def _take(self, sample: RdtSample, now: float) -> int:
        """Store a usable sample; return the flags of its faults."""
        self.status = sample.status
        if not is_usable(sample.status):
            return _SATURATED if sample.status & SATURATED else _STATUS
        flags = _LATCHED if sample.status == THRESHOLD_LATCHED else 0
        if (np.abs(np.array(sample.counts)) > self._limits).any():
            return flags | _RANGE
        self.good.row[:] = sample.time, *sample.counts
        self.good.push()
        self._last_usable = now
        return flags

    def _request_stream(self) -> None:
        self.requests += 1
        self.send(RdtCommand.STREAM)


@compiled
def _kept(
    stream: Indices, clock: Array, datagram: bytes, now: float, limits: Array,
    row: Array, rows: Array, ends: Indices, time: float,
) -> float:  # fmt: skip
    """Store the sample of a normal datagram; return the newest sample's time [s].

    Return minus infinity for any other datagram, which must be passed to `Stream.feed`.
    """
    if not follow(stream, clock, datagram, now, limits, row):
        return -math.inf
    return push(rows, ends, row, time)


class NetftSensors:
    """Base sensors in the order of the tubes, each with a separate box."""

    def __init__(
        self, links: Sequence[Datagrams], pages: Sequence[NetftPage], settings: NetftSettings | None = None
    ) -> None:
        settings = self._settings = settings or NetftSettings()
        self._history = SampleHistory(np.array([[page.force_count] * 3 + [page.torque_count] * 3 for page in pages]))
        self._sensors = [
            _Sensor(link, page, settings, self._history.ring(i))
            for i, (link, page) in enumerate(zip(links, pages, strict=True))
        ]
        for sensor in self._sensors:
            sensor.warm_up()
        self._reading = WrenchReading(0.0, self._history.at(0.0), usable=False)
        self._time = -math.inf  # time of the reading; never decreases
        self._started = False

    @property
    def quality(self) -> tuple[WrenchQuality, ...]:
        """Quality of each sensor at the last poll."""
        return tuple(WrenchQuality(sensor.flags) for sensor in self._sensors)

    @property
    def is_usable(self) -> bool:
        """Whether the last reading is valid for control."""
        return self._reading.usable

    @property
    def counters(self) -> tuple[Counters, ...]:
        """Counters of each stream since its start."""
        return tuple(sensor.stream.counters for sensor in self._sensors)

    def complaint(self) -> str:
        """Return the faults as human-readable text; "" if there is none."""
        return "; ".join(
            f"force sensor {number} on {sensor.link.name}: "
            + ", ".join(str(flag.name).lower() for flag in WrenchQuality if flag in quality)
            + (
                f", nothing usable for {1e3 * self._settings.stale_after:.0f} ms"
                if WrenchQuality.STALE in quality
                else ""
            )
            + (f" [{describe(sensor.status)}]" if sensor.status else "")
            for number, (sensor, quality) in enumerate(zip(self._sensors, self.quality, strict=True), 1)
            if not quality.is_usable
        )

    @property
    def condition(self) -> Condition:
        """CONNECTED after every sensor has sent a usable sample; `trouble` reports later faults."""
        if not self._started:
            return Condition.CLOSED
        return Condition.CONNECTED if math.isfinite(self._time) else Condition.CONNECTING

    def connect(self, now: float) -> None:
        """Request the streams; `trouble` reports a lost port."""
        with contextlib.suppress(LinkError):
            self.start(now)

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - the state is that of the last poll
        """Return a HOLD with the box's status if a sensor has no valid sample."""
        if self._reading.usable:
            return None
        found = [
            f"force sensor {number} {next(text for flag, text in HAPPENED.items() if flag in quality)}"
            for number, quality in enumerate(self.quality, 1)
            if not quality.is_usable
        ]
        return DeviceFault(Severity.HOLD, "; ".join(found), self.complaint())

    def details(self) -> Mapping[str, Any]:
        """Return identities and counters of the sensors."""
        return {
            sensor.link.name: {
                "calibration": sensor.page.serial,
                "quality": [str(flag.name).lower() for flag in WrenchQuality if flag in quality],
                "requests": sensor.requests,
                **vars(sensor.stream.counters),
            }
            for sensor, quality in zip(self._sensors, self.quality, strict=True)
        }

    def start(self, now: float) -> None:
        """Request the streams; the operator also does this after a box has restarted.

        Raises:
            LinkError: a port is gone.
        """
        self._reading = self._reading._replace(time=now, usable=False)
        self._time, self._started = -math.inf, True
        for sensor in self._sensors:
            sensor.start(now)

    def poll(self, now: float) -> WrenchReading:
        """Return the wrenches at the newest time for which every sensor that is not stale has a sample.

        A sensor whose `quality` is not usable keeps its last valid wrench. Until every sensor has had a valid sample,
        all wrenches are zero.
        """
        received, complete, flags, time = False, True, 0, math.inf
        for sensor in self._sensors:
            received |= sensor.poll(now)
            flags |= sensor.flags
            newest = sensor.good.time
            if newest == -math.inf:
                complete = False
            elif newest < time and not sensor.flags & _STALE:
                time = newest
        usable = not flags & ~(_LATCHED | _GAP)
        if complete and received and time < math.inf:
            self._time = time = max(self._time, time)
            self._reading = WrenchReading(time, self._history.at(time), usable)
        elif usable != self._reading.usable:
            self._reading = self._reading._replace(usable=usable)
        return self._reading

    def stop(self) -> None:
        """End the streams."""
        for sensor in self._sensors:
            sensor.stop()

    def close(self) -> None:
        """End the streams and close all ports, even if some are lost."""
        for sensor in self._sensors:
            try:
                sensor.stop()
            except LinkError:
                continue
            finally:
                sensor.link.close()


def fetch_page(host: str, port: int = 80, timeout: float = 2.0) -> NetftPage:
    """Fetch the configuration page of a box.

    Raises:
        SensorError: the box does not answer.
        PageError: the page is invalid.
    """
    url = f"http://{host}:{port}/netftapi2.xml"
    page = b""
    try:
        # Without proxies from the environment and without redirections, so that only the box itself answers. The box
        # has no TLS, so no certificates are loaded, which would take 0.1 s.
        client = httpx.Client(timeout=timeout, trust_env=False, verify=False)  # noqa: S501
        with client, client.stream("GET", url) as answer:
            if answer.status_code != 200:
                raise SensorError(f"{url} answers {answer.status_code}; is this an ATI Net F/T?")
            for part in answer.iter_bytes():
                page += part
                if len(page) > MAX_PAGE_BYTES:
                    break
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise SensorError(f"{url} does not answer: {error}; is the box switched on, and in this network?") from None
    return read_page(page)


def connect(boxes: Sequence[ForceBoxFile], settings: NetftSettings | None = None) -> NetftSensors:
    """Open the boxes of the tubes' sensors, in the order of the tubes; blocks, and does not start the streams.

    Raises:
        SensorError: a box does not answer or is not the expected one.
        PageError: the page of a box is invalid.
        LinkError: the address of a box is unknown, or another station uses the box.
    """
    pages = [fetch_page(box.host, box.http_port) for box in boxes]
    for box, page in zip(boxes, pages, strict=True):
        if box.serial is not None and page.serial != box.serial:
            raise SensorError(
                f"the force sensor at {box.host} has calibration '{page.serial}', expected '{box.serial}'; "
                "are the cables or addresses exchanged?"
            )
    links: list[DatagramLink] = []
    try:
        links.extend(DatagramLink(box.host, box.rdt_port) for box in boxes)
    except LinkError:
        for link in links:
            link.close()
        raise
    return NetftSensors(links, pages, settings)


def netft(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], BaseSensors]:
    """Return the opener of ATI Net F/T boxes; raises ConfigError."""
    file = check(NetftFile, options, "devices.sensors")
    boxes = in_order(file.tubes, [tube.name for tube in robot.tubes], "devices.sensors.tubes")
    return lambda: mounted(connect(boxes, file), [box.mount for box in boxes])
