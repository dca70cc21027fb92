"""Driver of base sensors with one ATI Net F/T box each; interpolates their samples to a common time. No threads.

An invalid sample never replaces the last valid wrench of its sensor. `quality` reports the faults of the samples.
"""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Protocol

import httpx
import numpy as np
from pydantic import Field

from core.compiled import compiled
from core.errors import CtrError
from core.robot.robot import Array, Indices
from station.config.robots import RobotFile
from station.config.strict import MAX_SILENCE_S, ConfigError, Latency, Name, Positive, Row, Strict, check
from station.devices.ati.calibration import MAX_PAGE_BYTES, NetftPage, read_page
from station.devices.ati.protocol import (
    LATENCY_S,
    MIN_RECORD_RATE_HZ,
    RDT_PORT,
    RECORD,
    SAMPLE_RATE_HZ,
    SATURATED,
    THRESHOLD_LATCHED,
    Counters,
    RdtCommand,
    RdtSample,
    SampleHistory,
    SampleRing,
    Stream,
    describe,
    follow,
    is_usable,
    push,
    request,
)
from station.devices.config import Mount, TcpPort, mounted, sensor_tables, twins
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, WrenchReading
from station.devices.kernel.quality import Quality, Sampled, quoted, sample_fault
from station.devices.kernel.sampled import observe
from station.devices.links.link import DatagramLink, LinkError


class SensorError(CtrError):
    """A force sensor cannot be reached or is not the expected one; the text names the sensor and what to do."""


#: Silence after which the driver requests the stream again [s].
RETRY_AFTER_S = 0.5
#: Number of further attempts to connect to a box, which may be starting; after 0, 0.5, 1, 2 and 4 s.
BOOT_ATTEMPTS = 5


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

    stale_after: Annotated[float, Field(gt=0.0, le=MAX_SILENCE_S)] = 0.05
    """time without a usable record after which a sensor counts as stale [s]"""
    latency: Latency = LATENCY_S
    """time from a measurement until the box sends its record [s]"""
    ranges: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], Row] = (
        18.0, 18.0, 18.0, 0.25, 0.25, 0.25,
    )  # fmt: skip
    """calibrated ranges of Fx Fy Fz Tx Ty Tz, used if the box's configuration page has none [N, N m]; default: those of
    a Nano43 SI-18-0.25"""


class NetftFile(NetftSettings):
    """ATI Net F/T boxes, one for each sensor."""

    tubes: Mapping[Name, ForceBoxFile] = {}
    """box of the sensor at each tube, by the name of the tube"""
    robot: ForceBoxFile | None = None
    """box of the sensor under the whole robot, with `at = "robot"`"""


class Datagrams(Protocol):
    """A link of whole datagrams to one box: UDP, or a queue in memory."""

    name: str  #: name of the link in messages

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
_LATCHED, _GAP, _STALE = int(Quality.LATCHED), int(Quality.GAP), int(Quality.STALE)


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
        self.unread = b""  #: the newest datagram that has arrived since the last sample; empty: none
        self._settings = settings
        scale = [page.force_count] * 3 + [page.torque_count] * 3
        self._limits = np.array(page.ranges or settings.ranges) / scale
        self._last_received = self._last_usable = 0.0
        self._streaming = False
        self._latched_flags = 0  # flags that stay until the operator starts the stream again
        self._newest = 0  # flags of the newest records

    def warm_up(self) -> None:
        """Load the compiled code now, because the first call takes longer than a tick."""
        observe(self.stream.clock.state.copy(), 0, self.stream.clock.latest(0.0))
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
                self._last_received, self.unread = now, datagram
                counters = stream.counters
                lost, resets = counters.lost, counters.resets
                for sample in stream.feed(datagram, now):
                    newest |= self._take(sample, now)
                    received = True
                flags |= (_GAP if counters.lost > lost else 0) | (
                    int(Quality.RESTARTED) if counters.resets > resets else 0
                )
            if received:
                self._last_received, self._newest, self.unread = now, newest, b""
            elif self._streaming and now - self._last_received >= RETRY_AFTER_S:
                self._last_received = now
                stream.restart()
                self._request_stream()
        except LinkError:
            flags |= int(Quality.LOST)
        if flags & int(Quality.RESTARTED):
            self._latched_flags |= int(Quality.RESTARTED)
            good.clear()
        flags |= self._newest | self._latched_flags
        if good.time == -math.inf or now - self._last_usable > self._settings.stale_after:
            flags |= _STALE | int(flags == 0 and self._why_stale())
        self.flags = flags
        return received

    def _why_stale(self) -> Quality:
        if (self.stream.record_rate or math.inf) < self._needed_rate:
            return Quality.WRONG_RATE
        return Quality.UNREADABLE if self.unread else Quality.SILENT

    @property
    def _needed_rate(self) -> int:
        """Smallest rate of the records with which the sensor never counts as stale [1/s]."""
        return max(MIN_RECORD_RATE_HZ, math.ceil(2.0 / self._settings.stale_after))

    def because(self) -> str:
        """Return the predicate of a sentence about what is wrong with the stream; empty if nothing is wrong."""
        rate, counted = self.stream.record_rate, self.stream.clock.wrong_rate
        if self.flags & Quality.WRONG_RATE:
            return f"sends {rate:.3g} records/s, at least {self._needed_rate} are needed: set the RDT rate on its page"
        if self.flags & Quality.UNREADABLE and len(self.unread) % RECORD.size:
            return f"sends {quoted(self.unread)}, expected records of {RECORD.size} bytes: check 'host' and 'rdt_port'"
        if self.flags & Quality.UNREADABLE:
            return f"sends {quoted(self.unread)}, whose counters do not continue: switch the box off and on"
        if not self.flags & ~(_LATCHED | _GAP) and counted:
            return f"counts {counted:.0f} samples/s instead of {SAMPLE_RATE_HZ:g}: check that it is an ATI Net F/T"
        return ""

    def _take(self, sample: RdtSample, now: float) -> int:
        """Store a sample if it is usable; return the flags of its faults."""
        self.status = sample.status
        if not is_usable(sample.status):
            return int(Quality.SATURATED if sample.status & SATURATED else Quality.DEVICE_FAULT)
        flags = _LATCHED if sample.status == THRESHOLD_LATCHED else 0
        if (np.abs(np.array(sample.counts)) > self._limits).any():
            return flags | int(Quality.RANGE)
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
    def quality(self) -> tuple[Quality, ...]:
        """Quality of each sensor at the last poll."""
        return tuple(Quality(sensor.flags) for sensor in self._sensors)

    @property
    def is_usable(self) -> bool:
        """Whether the last reading is valid for control."""
        return self._reading.usable

    @property
    def counters(self) -> tuple[Counters, ...]:
        """Counters of each stream since its start."""
        return tuple(sensor.stream.counters for sensor in self._sensors)

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

    def trouble(self, now: float) -> DeviceFault | None:
        """Return a HOLD with the box's status if a sensor had no valid sample at the last poll."""
        if self._reading.usable and not any(sensor.stream.clock.wrong_rate for sensor in self._sensors):
            return None
        return sample_fault([
            Sampled(
                f"force sensor {number}",
                quality,
                now - sensor.good.time,
                f"force sensor {number} on {sensor.link.name}: {', '.join(quality.words or ['usable'])}"
                + (f" [{describe(sensor.status)}]" if sensor.status else ""),
                because,
            )
            for number, (sensor, quality) in enumerate(zip(self._sensors, self.quality, strict=True), 1)
            if (because := sensor.because()) or not quality.is_usable
        ], math.inf if self._reading.usable else 0.0)  # fmt: skip

    def details(self) -> Mapping[str, Any]:
        """Return identities and counters of the sensors."""
        return {
            sensor.link.name: {
                "calibration": sensor.page.serial,
                "quality": quality.words,
                "requests": sensor.requests,
                **vars(sensor.stream.counters),
            }
            for sensor, quality in zip(self._sensors, self.quality, strict=True)
        }

    def start(self, now: float) -> None:
        """Request the streams, at the start and when the operator connects again after a box has restarted.

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


def fetch_page(host: str, port: int = 80, timeout: float = 2.0, attempts: int = BOOT_ATTEMPTS) -> NetftPage:
    """Fetch the configuration page of a box; `attempts` is the number of retries if it cannot be connected.

    Raises:
        SensorError: the box does not answer.
        PageError: the page is invalid.
    """
    url = f"http://{host}:{port}/netftapi2.xml"
    page = b""
    try:
        # Use no proxies from the environment and follow no redirections, so that only the box itself answers. Load no
        # certificates, which would take 0.1 s, because the box has no TLS.
        transport = httpx.HTTPTransport(verify=False, trust_env=False, retries=attempts)
        client = httpx.Client(timeout=timeout, trust_env=False, transport=transport)
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


def check_identities(boxes: Sequence[ForceBoxFile], pages: Sequence[NetftPage]) -> None:
    """Check that each box has its expected sensor, and that no two boxes have the same one; raises SensorError."""
    for box, page in zip(boxes, pages, strict=True):
        if box.serial is not None and page.serial != box.serial:
            raise SensorError(
                f"the force sensor at {box.host} has calibration '{page.serial}', expected '{box.serial}'; "
                "are the cables or addresses exchanged?"
            )
    if same := twins({f"{box.host}:{box.rdt_port}": page.serial for box, page in zip(boxes, pages, strict=True)}):
        raise SensorError(
            f"the force sensors at {' and '.join(same)} have the same calibration: is it one box with two addresses?"
            " Set 'host' of each tube to its own box, or load each sensor's calibration"
        )


def connect(
    boxes: Sequence[ForceBoxFile], settings: NetftSettings | None = None, attempts: int = BOOT_ATTEMPTS
) -> NetftSensors:
    """Open the boxes in the order of the tubes, without starting their streams; waits for each box's web page.

    Raises:
        SensorError: a box does not answer or is not the expected one.
        PageError: the page of a box is invalid.
        LinkError: the address of a box is unknown, or another station uses the box.
    """
    pages = [fetch_page(box.host, box.http_port, attempts=attempts) for box in boxes]
    check_identities(boxes, pages)
    links: list[DatagramLink] = []
    try:
        links.extend(DatagramLink(box.host, box.rdt_port) for box in boxes)
    except LinkError:
        for link in links:
            link.close()
        raise
    return NetftSensors(links, pages, settings)


def netft(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], BaseSensors]:
    """Check the options, and return the function that opens the ATI Net F/T boxes; raises ConfigError."""
    file = check(NetftFile, options, "devices.sensors")
    boxes, _ = sensor_tables(file.tubes, file.robot, robot)
    if same := twins({name: (box.host, box.rdt_port) for name, box in file.tubes.items()}):
        raise ConfigError(
            f"devices.sensors.tubes.{same[1]}.host = '{file.tubes[same[1]].host}': {same[0]} has the same box;"
            " give each tube a different one"
        )
    return lambda: mounted(connect(boxes, file), [box.mount for box in boxes])
