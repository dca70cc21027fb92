"""A simulated ATI Net F/T box at wire level: requests in, records out, with the sensor's imperfections.

Gain, cross-talk, noise, quantisation, offset and drift on the true base wrench; the box's own counter, its delay, its
end of range; and what can go wrong on the way. Only the latest that asked for a stream is served.
"""

import math
import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.robot.robot import Array
from station.devices.netft.protocol import ERROR_SUMMARY, HEADER, LATENCY, RECORD, REQUEST, SATURATED, WRAP, Command
from station.lab.config import BaseSensorConfig
from station.lab.netft.wire import Address, DeviceEnd

Octets = NDArray[np.uint8]
#: The internal counter of a perfect box [1/s].
RATE = 7000.0
#: A request that names the host to be served: bit 15 of the command, and an IPv4 address and a port at the end.
ELSEWHERE = 0x8000
LONG_REQUEST = struct.Struct(">HHI4sH")
#: Noise is drawn for so many records at once.
BLOCK = 256
#: Datagrams that a delay can keep on the way; the oldest get lost.
MOST_ON_THE_WAY = 65536


@dataclass(frozen=True)
class BoxSettings:
    """The box and its calibration; a Nano43 SI-18-0.25 unless told otherwise."""

    rate: float = 500.0  #: asked for; what it becomes is 7000/n [records/s]
    force_range: float = 18.0  #: [N]
    torque_range: float = 0.25  #: [N m]
    force_counts: int = 1_000_000  #: per newton
    torque_counts: int = 1_000_000  #: per newton metre
    product: str = "Net F/T (simulated)"
    serial: str = "FT00001"
    address: str = "192.168.1.1"  #: as the page has it
    buffer: int = 10  #: records a datagram when buffered
    latency: float = LATENCY  #: from the event to the Ethernet [s]
    first: float = 0.002  #: from a request to the first record, up to 0.005 in a real one [s]
    clock_error: float = 0.0  #: of the counter's rate, up to +-0.005 in a real one
    first_count: int = 6433  #: of the counter at time 0

    @property
    def divisor(self) -> int:
        """What 7000 is divided by."""
        return max(1, min(7000, round(RATE / self.rate)))


@dataclass
class NetftFaults:
    """What goes wrong from now on; parts are probabilities a datagram."""

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0  #: changes places with the next
    flip: float = 0.0  #: one bit, as if UDP's checksum had missed it
    mute: bool = False  #: neither hears nor sends, as if unplugged
    saturate: bool = False  #: as if overloaded
    freeze: bool = False  #: the same sample again and again
    status: int = 0  #: bits set in each record
    delay: float = 0.0  #: on top of the latency [s]


class SimulatedNetft:
    """One box and its transducer."""

    def __init__(
        self,
        end: DeviceEnd,
        config: BaseSensorConfig,
        rng: np.random.Generator,
        settings: BoxSettings | None = None,
    ) -> None:
        self.settings = settings or BoxSettings()
        self.faults = NetftFaults()
        self._end = end
        self._rng, self._chance = rng, rng.spawn(1)[0]
        own = self.settings
        offset = np.repeat([config.force_offset, config.moment_offset], 3) * rng.uniform(-1.0, 1.0, 6)
        drift = np.concatenate([config.drift * rng.choice([-1.0, 1.0], 3), np.zeros(3)])
        # By rows: offset, drift [1/s], deviation of the noise, step of quantisation, range, bias [N, N m]; counts of 1.
        self._axes = np.array(
            [
                offset,
                drift,
                np.repeat([config.force_noise, config.moment_noise], 3),
                np.repeat([config.force_count, config.moment_count], 3),
                np.repeat([own.force_range, own.torque_range], 3),
                np.zeros(6),
                np.repeat([own.force_counts, own.torque_counts], 3),
            ]
        )
        #: What each axis reads of each beside itself; None: nothing.
        self._skew = skew(config.gain, own, rng.spawn(1)[0]) if config.gain > 0.0 else None
        self._noise, self._drawn = np.empty((BLOCK, 6)), BLOCK
        self._bytes = np.zeros(RECORD.size, np.uint8)
        self._true = np.zeros(6)
        self._now = 0.0
        self._divisor = own.divisor
        self._period = own.divisor / (RATE * (1.0 + self.settings.clock_error))
        self._slack = 1e-6 * self._period
        self._first_count = self.settings.first_count
        self._next = 0  # record of the box's own grid
        self._on_the_way: deque[tuple[float, bytes, Address]] = deque(maxlen=MOST_ON_THE_WAY)
        self._held: tuple[float, bytes, Address] | None = None  # the one that changes places
        self._power_up()

    def advance(self, now: float, wrench: Array) -> None:
        """Hear what was asked, feel the wrench (6,) [N, N m] go on to this one until `now` [s], send."""
        if self._skew is not None:
            wrench = wrench + self._skew @ wrench
        begin, before = self._now, self._true
        for datagram, sender in self._end.receive():
            if not self.faults.mute:
                self._hear(datagram, sender)
        if self._client is None:
            self._next = max(self._next, math.floor(now / self._period + 1e-6) + 1)
        while self._client is not None and (time := self._next * self._period) <= now + self._slack:
            if time >= self._begins:
                part = (time - begin) / (now - begin) if begin < time < now else float(time >= now)
                self._measure(time, before, wrench, part)
            self._next += 1
        self._now, self._true = now, wrench
        way = self._on_the_way
        while way and way[0][0] <= now + 1e-9:
            _, datagram, to = way.popleft()
            if not self.faults.mute:
                self._end.send(datagram, to)

    def reboot(self) -> None:
        """Power off and on: the counter, the bias and the stream are gone."""
        self._first_count = -round(self._now / self._period) * self.settings.divisor
        self._on_the_way.clear()
        self._power_up()

    def page(self) -> bytes | None:
        """`netftapi2.xml`; None if the box is mute."""
        if self.faults.mute:
            return None
        own, (_, _, status, *counts) = (
            self.settings,
            RECORD.unpack(self._read(0, self._now, self._true, self._true, 1.0)),
        )
        ranges = [own.force_range] * 3 + [own.torque_range] * 3
        elements = {
            "runstat": f"0x{status:08X}",
            "runft": _array(counts),
            "runsg": _array([0] * 6),
            "prodname": own.product,
            "setbias": _array([round(bias * scale) for bias, scale in self._axes[5:].T.tolist()]),
            "cfgnam": own.serial,
            "cfgcalsn": own.serial,
            "cfgfu": "2",
            "scfgfu": "N",
            "cfgtu": "3",
            "scfgtu": "N-m",
            "cfgcpf": str(own.force_counts),
            "cfgcpt": str(own.torque_counts),
            "cfgmr": _array([f"{value:g}" for value in ranges]),
            "netip": own.address,
            "comrdte": "Enabled",
            "comrdtrate": str(round(RATE / own.divisor)),
            "comrdtbsiz": str(own.buffer),
        }
        body = "".join(f"<{name}>{text}</{name}>\n" for name, text in elements.items())
        return f'<?xml version="1.0"?>\n<netft>\n{body}</netft>\n'.encode()

    def _power_up(self) -> None:
        self._axes[5] = 0.0
        self._client: Address | None = None
        self._begins = 0.0
        self._left = 0  # records to send; 0: until stopped
        self._sequence = 0
        self._batch = 1
        self._buffered = b""
        self._record: bytes | None = None  # the newest

    def _hear(self, datagram: bytes, sender: Address) -> None:
        """One request; whatever is not one is ignored, as the box does."""
        if len(datagram) < REQUEST.size:
            return
        header, command, samples = REQUEST.unpack_from(datagram)
        if command & ELSEWHERE:
            if len(datagram) != LONG_REQUEST.size:
                return
            address, port = datagram[8:12], int.from_bytes(datagram[12:14], "big")
            sender, command = (".".join(map(str, address)), port), command & ~ELSEWHERE
        elif len(datagram) != REQUEST.size:
            return
        if header != HEADER:
            return
        if command in (Command.STREAM, Command.STREAM_BUFFERED):
            self._on_the_way.clear()  # the box has heard the request before it would have sent these
            self._client, self._begins, self._left = sender, self._now + self.settings.first, samples
            self._sequence, self._buffered = 0, b""
            self._batch = self.settings.buffer if command == Command.STREAM_BUFFERED else 1
        elif command == Command.STOP:
            self._on_the_way.clear()
            self._client, self._buffered = None, b""
        elif command == Command.BIAS:
            counts = RECORD.unpack(self._read(0, self._now, self._true, self._true, 1.0))[3:]
            self._axes[5] += np.array(counts) / self._axes[6]
        elif command == Command.RESET_LATCH:
            self.faults.status &= ~(1 << 16)

    def _read(self, sequence: int, time: float, before: Array, after: Array, part: float) -> bytes:
        """A record of what the box makes of the wrench between two (6,)."""
        if self._drawn == BLOCK:
            self._noise, self._drawn = self._rng.standard_normal((BLOCK, 6)), 0
        counter = (self._first_count + self._next * self._divisor) % WRAP
        faults, record = self.faults, self._bytes
        _sense(
            self._axes, self._noise, self._drawn, time, before, after, part, faults.saturate,
            sequence, counter, faults.status, record,
        )  # fmt: skip
        self._drawn += 1
        return record.tobytes()

    def _measure(self, time: float, before: Array, after: Array, part: float) -> None:
        """One record of the stream."""
        sequence = self._sequence = (self._sequence + 1) % WRAP
        if not self.faults.freeze or self._record is None:
            self._record = self._read(sequence, time, before, after, part)
        else:
            self._record = sequence.to_bytes(4, "big") + self._record[4:]
        if self._batch == 1:
            self._send(time, self._record)
        else:
            self._buffered += self._record
            if self._left == 1 or len(self._buffered) >= self._batch * RECORD.size:
                self._send(time, self._buffered)
                self._buffered = b""
        if self._left == 1:
            self._client = None
        if self._left:
            self._left -= 1

    def _send(self, time: float, datagram: bytes) -> None:
        """Let a datagram go its way, with what can happen to it there."""
        faults, chance = self.faults, self._chance
        if self._client is None or (faults.drop and chance.random() < faults.drop):
            return
        if faults.flip and chance.random() < faults.flip:
            bit = int(chance.integers(8 * len(datagram)))
            spoilt = bytearray(datagram)
            spoilt[bit // 8] ^= 1 << bit % 8
            datagram = bytes(spoilt)
        item = (time + self.settings.latency + faults.delay, datagram, self._client)
        if faults.reorder and self._held is None and chance.random() < faults.reorder:
            self._held = item
            return
        self._on_the_way.append(item)
        if faults.duplicate and chance.random() < faults.duplicate:
            self._on_the_way.append(item)
        if self._held is not None:
            self._on_the_way.append((item[0], *self._held[1:]))
            self._held = None


def skew(most: float, box: BoxSettings, rng: np.random.Generator) -> Array:
    """Errors of gain and cross-talk (6, 6): fractions within +-`most` of one axis's range by another's."""
    ranges = np.repeat([box.force_range, box.torque_range], 3)
    return most * rng.uniform(-1.0, 1.0, (6, 6)) * ranges[:, None] / ranges


@compiled
def _sense(
    axes: Array, noise: Array, row: int, time: float, before: Array, after: Array, part: float, saturate: bool,
    sequence: int, counter: int, status: int, record: Octets,
) -> None:  # fmt: skip
    """The record, as it goes out, of the wrench between two; `axes` as in the box."""
    words = np.empty(9, np.int64)
    for k in range(6):
        value = before[k] + part * (after[k] - before[k]) + axes[0, k] + time * axes[1, k] + axes[2, k] * noise[row, k]
        if axes[3, k] > 0.0:
            value = np.rint(value / axes[3, k]) * axes[3, k]
        reach = axes[4, k]
        if saturate or not -reach <= value <= reach:
            status, value = status | SATURATED, math.copysign(reach, value)
        words[3 + k] = np.int64(np.rint((value - axes[5, k]) * axes[6, k]))
    words[0], words[1], words[2] = sequence, counter, status | ERROR_SUMMARY if status else 0
    for i in range(9):
        for k in range(4):
            record[4 * i + k] = words[i] >> (24 - 8 * k) & 255  # the most significant byte first


def _array(values: Iterable[int | str]) -> str:
    return ";".join(str(value) for value in values)
