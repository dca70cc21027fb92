"""Base sensors behind ATI Net F/T boxes: one box a sensor, brought to one sample; no threads.

What comes is not always fit for control. A sample that is not never replaces the last good one: the
reading stays, and `quality` says what is wrong with it.
"""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any, NamedTuple, Protocol

import httpx
import numpy as np

from core.compiled import compiled
from core.errors import CtrError
from core.robot.robot import Array, Indices
from station.devices.interfaces import Condition, Severity, Trouble, WrenchReading
from station.devices.links.link import DatagramLink, LinkError
from station.devices.netft.clock import SampleClock
from station.devices.netft.history import History, Ring, push
from station.devices.netft.page import LARGEST_PAGE, NetftPage, read_page
from station.devices.netft.protocol import (
    LATENCY,
    RDT_PORT,
    SATURATED,
    THRESHOLD_LATCHED,
    Command,
    Counters,
    Sample,
    Stream,
    describe,
    follow,
    is_usable,
    request,
)


class SensorError(CtrError):
    """A force sensor that cannot be reached or is not the one expected; names it and what to do."""


class Quality(IntFlag):
    """What is wrong with a sensor's reading; 0: nothing."""

    GOOD = 0
    LATCHED = 1  #: a monitor condition has latched in the box; a warning
    GAP = 2  #: records were lost since the last poll; a warning
    STALE = 4  #: nothing usable has come for too long, or nothing yet
    SATURATED = 8  #: the transducer or its converter is at its end
    STATUS = 16  #: the box says that something else is wrong
    RANGE = 32  #: more than the calibration covers, though the box says nothing
    RESET = 64  #: the box has started anew since the stream began: its bias and its identity are open
    GONE = 128  #: the link is gone

    @property
    def is_usable(self) -> bool:
        """Whether control may use the reading."""
        return not self & ~(Quality.LATCHED | Quality.GAP)


@dataclass(frozen=True)
class NetftSettings:
    """What the driver has to be told."""

    stale_after: float = 0.05  #: without a usable record [s]
    retry_after: float = 0.5  #: of silence the stream is asked for again, and every so often [s]
    latency: float = LATENCY  #: from the event to the Ethernet [s]
    ranges: tuple[float, ...] = (18.0, 18.0, 18.0, 0.25, 0.25, 0.25)  #: Nano43 SI-18-0.25, if the page tells none


class Datagrams(Protocol):
    """A link of whole datagrams to one box: UDP, or a queue in memory."""

    name: str  #: for messages

    def receive(self) -> list[bytes]:
        """Whole datagrams that have arrived."""
        ...

    def send(self, datagram: bytes) -> None:
        """Send one datagram, which may get lost."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


# Flags as plain numbers: those of `IntFlag` are slow, and these are put together at every tick.
_LATCHED, _GAP, _STALE, _SATURATED, _STATUS, _RANGE, _RESET, _GONE = (int(flag) for flag in Quality)


class _Sensor:
    """One box: its stream, what of it can be used, and the rest as quality."""

    def __init__(self, link: Datagrams, page: NetftPage, settings: NetftSettings, good: Ring) -> None:
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
        self._heard = self._fresh = 0.0
        self._streaming = False
        self._lasting = 0  # until the stream is started by a person
        self._newest = 0  # of the newest records

    def warm_up(self) -> None:
        """Have loaded what is compiled: the first call takes longer than a tick."""
        SampleClock().observe(0, SampleClock().latest(0.0))
        good = self.good
        _kept(*self.stream.state, b"", 0.0, self._limits, good.row, good.rows, good.ends, good.time)
        self.good.push()
        self.good.clear()

    def start(self, now: float) -> None:
        """Begin a stream, with nothing held against the box."""
        self._lasting = self._newest = 0
        self.flags = _STALE
        self.stream = Stream(self._settings.latency)
        self.good.clear()
        self._streaming = True
        self._heard = self._fresh = now
        self._ask()

    def stop(self) -> None:
        self._streaming = False
        self.send(Command.STOP)

    def send(self, command: Command) -> None:
        self.link.send(request(command))

    def poll(self, now: float) -> bool:
        """Take what has arrived; nothing of it raises. Whether there was anything."""
        stream, good, settings, flags = self.stream, self.good, self._settings, 0
        lost, resets, news, newest = stream.lost, stream.resets, False, 0
        try:
            for datagram in self.link.receive():
                numbers, clock = stream.state
                taken, good.time = _kept(
                    numbers, clock, datagram, now, self._limits, good.row, good.rows, good.ends, good.time
                )
                if taken:
                    self.status, self._fresh, news = 0, now, True
                    continue
                for sample in stream.feed(datagram, now):
                    newest |= self._take(sample, now)
                    news = True
            if news:
                self._heard, self._newest = now, newest
            elif self._streaming and now - self._heard >= settings.retry_after:
                self._heard = now
                stream.restart()
                self._ask()
        except LinkError:
            flags = _GONE
        if stream.resets > resets:
            self._lasting |= _RESET
            good.clear()
        flags |= self._newest | self._lasting
        if stream.lost > lost:
            flags |= _GAP
        if good.time == -math.inf or now - self._fresh > settings.stale_after:
            flags |= _STALE
        self.flags = flags
        return news

    def _take(self, sample: Sample, now: float) -> int:
        """Keep a sample that can be used; what is wrong with it."""
        self.status = sample.status
        if not is_usable(sample.status):
            return _SATURATED if sample.status & SATURATED else _STATUS
        flags = _LATCHED if sample.status == THRESHOLD_LATCHED else 0
        if (np.abs(np.array(sample.counts)) > self._limits).any():
            return flags | _RANGE
        self.good.row[:] = sample.time, *sample.counts
        self.good.push()
        self._fresh = now
        return flags

    def _ask(self) -> None:
        self.requests += 1
        self.send(Command.STREAM)


@compiled
def _kept(
    stream: Indices, clock: Array, datagram: bytes, now: float, limits: Array,
    row: Array, rows: Array, ends: Indices, time: float,
) -> tuple[bool, float]:  # fmt: skip
    """Keep the usual datagram: whether it was one (else it is for `Stream.feed`), and the newest sample's time."""
    if not follow(stream, clock, datagram, now, limits, row):
        return False, time
    return True, push(rows, ends, row, time)


class NetftSensors:
    """Sensors in the order of the tubes, each behind a box of its own."""

    def __init__(
        self, links: Sequence[Datagrams], pages: Sequence[NetftPage], settings: NetftSettings | None = None
    ) -> None:
        settings = self._settings = settings or NetftSettings()
        self._history = History(np.array([[page.force_count] * 3 + [page.torque_count] * 3 for page in pages]))
        self._sensors = [
            _Sensor(link, page, settings, self._history.ring(i))
            for i, (link, page) in enumerate(zip(links, pages, strict=True))
        ]
        for sensor in self._sensors:
            sensor.warm_up()
        self._reading = WrenchReading(0.0, self._history.at(0.0))
        self._time = -math.inf  # of the reading; it never runs back
        self._started = False

    @property
    def quality(self) -> tuple[Quality, ...]:
        """Of each sensor at the last poll."""
        return tuple(Quality(sensor.flags) for sensor in self._sensors)

    @property
    def is_usable(self) -> bool:
        """Whether control may use the last reading."""
        flags = 0
        for sensor in self._sensors:
            flags |= sensor.flags
        return not flags & ~(_LATCHED | _GAP)

    @property
    def pages(self) -> tuple[NetftPage, ...]:
        """What each box said at connect."""
        return tuple(sensor.page for sensor in self._sensors)

    @property
    def counters(self) -> tuple[Counters, ...]:
        """Of each stream since it was started."""
        return tuple(sensor.stream.counters for sensor in self._sensors)

    @property
    def requests(self) -> tuple[int, ...]:
        """How often each stream had to be asked for."""
        return tuple(sensor.requests for sensor in self._sensors)

    def complaint(self) -> str:
        """What is wrong, for a person; "" if nothing is."""
        return "; ".join(
            f"force sensor {number} ({sensor.link.name}): "
            + ", ".join(str(flag.name).lower() for flag in Quality if flag in quality)
            + (f", nothing usable for {1e3 * self._settings.stale_after:.0f} ms" if Quality.STALE in quality else "")
            + (f" [{describe(sensor.status)}]" if sensor.status else "")
            for number, (sensor, quality) in enumerate(zip(self._sensors, self.quality, strict=True), 1)
            if not quality.is_usable
        )

    @property
    def condition(self) -> Condition:
        """CONNECTED once every sensor has sent something usable: what is amiss since then is `trouble`."""
        if not self._started:
            return Condition.CLOSED
        return Condition.CONNECTED if math.isfinite(self._time) else Condition.CONNECTING

    def connect(self, now: float) -> None:
        """Ask for the streams; a port that is gone shows in `trouble`."""
        with contextlib.suppress(LinkError):
            self.start(now)

    def trouble(self, now: float) -> Trouble | None:  # noqa: ARG002 - it is as at the last poll
        """Nothing fit for control from some sensor: HOLD, with what the box says."""
        return None if self.is_usable else Trouble(Severity.HOLD, self.complaint())

    def details(self) -> Mapping[str, Any]:
        """Who the sensors are and what they have counted."""
        return {
            sensor.link.name: {
                "calibration": sensor.page.serial,
                "quality": [str(flag.name).lower() for flag in Quality if flag in quality],
                "requests": sensor.requests,
                **sensor.stream.counters._asdict(),
            }
            for sensor, quality in zip(self._sensors, self.quality, strict=True)
        }

    def start(self, now: float) -> None:
        """Ask for the streams; also what a person does after a box has started anew.

        Raises:
            LinkError: a port is gone.
        """
        self._reading, self._time, self._started = self._reading._replace(time=now), -math.inf, True
        for sensor in self._sensors:
            sensor.start(now)

    def bias(self) -> None:
        """Make what each box feels now its zero; the next records still come from before."""
        for sensor in self._sensors:
            sensor.send(Command.BIAS)

    def reset_latch(self) -> None:
        """Forget the latched monitor conditions."""
        for sensor in self._sensors:
            sensor.send(Command.RESET_LATCH)

    def poll(self, now: float) -> WrenchReading:
        """The newest time that every sensor has reached, and the wrenches at it.

        A sensor whose `quality` is not usable keeps its last good wrench; before its first, all are zero.
        """
        news, complete, flags, time = False, True, 0, math.inf
        for sensor in self._sensors:
            news |= sensor.poll(now)
            flags |= sensor.flags
            if sensor.good.time == -math.inf:
                complete = False
            elif not sensor.flags & _STALE:
                time = min(time, sensor.good.time)
        usable = not flags & ~(_LATCHED | _GAP)
        if complete and news and time < math.inf:
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
        """End the streams and let go of the ports, of every one even if another has gone."""
        for sensor in self._sensors:
            try:
                sensor.stop()
            except LinkError:
                continue
            finally:
                sensor.link.close()


def fetch_page(host: str, port: int = 80, timeout: float = 2.0) -> NetftPage:
    """Ask a box for its configuration page.

    Raises:
        SensorError: it does not answer.
        PageError: what it answers cannot be trusted.
    """
    url = f"http://{host}:{port}/netftapi2.xml"
    page = b""
    try:
        # No proxy from the environment and no redirection: the box itself or nothing.
        with httpx.Client(timeout=timeout, trust_env=False) as client, client.stream("GET", url) as answer:
            if answer.status_code != 200:
                raise SensorError(f"{url} answers {answer.status_code}; is this an ATI Net F/T?")
            for part in answer.iter_bytes():
                page += part
                if len(page) > LARGEST_PAGE:
                    break
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise SensorError(f"{url} does not answer: {error}; is the box on, and in this network?") from None
    return read_page(page)


class BoxAddress(NamedTuple):
    """Where one box is, and which it must be."""

    host: str  #: name or address
    rdt_port: int = RDT_PORT
    http_port: int = 80
    serial: str | None = None  #: of its calibration; None takes what is there


def connect(boxes: Sequence[BoxAddress], settings: NetftSettings | None = None) -> NetftSensors:
    """Find the boxes of the tubes' sensors, in the order of the tubes; blocks, `start` is still to come.

    Raises:
        SensorError: a box does not answer or is another one.
        PageError: its page cannot be trusted.
        LinkError: its address means nothing, or another station has it.
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
