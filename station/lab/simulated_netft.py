"""A simulated ATI Net F/T force sensor (box and transducer) at wire level: it receives requests and sends records.

The simulation adds gain errors, cross-talk, noise, quantisation, offset and drift to the true base wrench. It includes
the box's counter, delay and range, and transmission faults. The box serves only the latest client that requested a
stream.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled
from core.robot.robot import Array
from station.devices.ati.protocol import (
    ERROR_SUMMARY,
    HEADER,
    LATENCY_S,
    RECORD,
    REQUEST,
    SATURATED,
    SEQUENCE_WRAP,
    RdtCommand,
)
from station.lab.config import BaseSensorConfig
from station.lab.wires import Address, DatagramDeviceEnd

Octets = NDArray[np.uint8]
#: Rate of the internal counter of a perfect box [1/s].
COUNTER_RATE_HZ = 7000.0
#: Number of records for which random noise is drawn at once, because single draws are slow.
NOISE_BLOCK = 256
#: Largest number of datagrams in transit; beyond it, the oldest are lost.
MAX_IN_FLIGHT = 65536


@dataclass(frozen=True)
class BoxSettings:
    """Settings of the simulated box and its calibration; the defaults are those of a Nano43 SI-18-0.25."""

    rate: float = 500.0  #: requested rate; the box uses the nearest 7000/n [records/s]
    force_range: float = 18.0  #: largest force that the sensor measures [N]
    torque_range: float = 0.25  #: largest torque that the sensor measures [N m]
    force_counts: int = 1_000_000  #: counts per newton in a record
    torque_counts: int = 1_000_000  #: counts per newton metre in a record
    product: str = "Net F/T (simulated)"
    serial: str = "FT00001"
    address: str = "192.168.1.1"  #: IP address that the box's page shows
    latency: float = LATENCY_S  #: time from the measurement to its record on the Ethernet [s]
    first: float = 0.002  #: time from a request to the first record, up to 0.005 for a real box [s]
    clock_error: float = 0.0  #: relative error of the counter's rate, up to +-0.005 for a real box
    first_count: int = 6433  #: value of the box's counter at time 0

    @property
    def divisor(self) -> int:
        """Divisor n of the record rate 7000/n."""
        return max(1, min(7000, round(COUNTER_RATE_HZ / self.rate)))


@dataclass
class NetftFaults:
    """Faults of the simulated box; the first four are probabilities per datagram."""

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0  #: the datagram is swapped with the next one
    flip: float = 0.0  #: one bit of the datagram is inverted, as if UDP's checksum had missed it
    mute: bool = False  #: the box neither receives nor sends, as if unplugged
    saturate: bool = False  #: the sensor reports an overload
    freeze: bool = False  #: the box repeats one sample
    status: int = 0  #: status bits that are set in each record
    delay: float = 0.0  #: delay of every datagram in addition to the latency [s]


class SimulatedNetft:
    """One simulated Net F/T box and its transducer."""

    def __init__(
        self,
        end: DatagramDeviceEnd,
        config: BaseSensorConfig,
        rng: np.random.Generator,
        settings: BoxSettings | None = None,
    ) -> None:
        self.settings = settings or BoxSettings()
        self.faults = NetftFaults()
        self._end = end
        self._rng, self._chance = rng, rng.spawn(1)[0]
        box = self.settings
        offset = np.repeat([config.force_offset, config.moment_offset], 3) * rng.uniform(-1.0, 1.0, 6)
        drift = np.concatenate([config.drift * rng.choice([-1.0, 1.0], 3), np.zeros(3)])
        # Gain errors and the moments' drift have separate random streams, so that the other draws do not change.
        crossed, signs = rng.spawn(2)
        drift[3:] = config.moment_drift * signs.choice([-1.0, 1.0], 3)
        # Rows: offset, drift per second, standard deviation of the noise, quantisation step, range, bias [N, N m];
        # the last row is the number of counts per N or N m.
        self._axes = np.array(
            [
                offset,
                drift,
                np.repeat([config.force_noise, config.moment_noise], 3),
                np.repeat([config.force_count, config.moment_count], 3),
                np.repeat([box.force_range, box.torque_range], 3),
                np.zeros(6),
                np.repeat([box.force_counts, box.torque_counts], 3),
            ]
        )
        self.offset = self._axes[0]  #: offset (6,), which a test may change [N, N m]
        #: Gain and cross-talk errors (6, 6), which a test may change; None: no errors.
        self.skew = gain_errors(config.gain, box, crossed) if config.gain > 0.0 else None
        self._noise, self._drawn = np.empty((NOISE_BLOCK, 6)), NOISE_BLOCK
        self._bytes = np.zeros(RECORD.size, np.uint8)
        self._true = np.zeros(6)
        self._now = 0.0
        self._divisor = box.divisor
        self._period = box.divisor / (COUNTER_RATE_HZ * (1.0 + self.settings.clock_error))
        self._slack = 1e-6 * self._period
        self._first_count = self.settings.first_count
        self._next = 0  # index of the next record in the box's time grid
        self._in_flight: deque[tuple[float, bytes, Address]] = deque(maxlen=MAX_IN_FLIGHT)
        self._swapped: tuple[float, bytes, Address] | None = None  # datagram that is sent after the next one
        self._power_up()

    def advance(self, now: float, wrench: Array) -> None:
        """Process requests, and send the records that are due until `now` [s].

        The wrench (6,) [N, N m] changes linearly from the previous call until `now`.
        """
        if self.skew is not None:
            wrench = wrench + self.skew @ wrench
        start, before = self._now, self._true
        for datagram, sender in self._end.receive():
            if not self.faults.mute:
                self._handle_request(datagram, sender)
        if self._client is None:
            self._next = max(self._next, math.floor(now / self._period + 1e-6) + 1)
        while self._client is not None and (time := self._next * self._period) <= now + self._slack:
            if time >= self._stream_start:
                part = (time - start) / (now - start) if start < time < now else float(time >= now)
                self._measure(time, before, wrench, part)
            self._next += 1
        self._now, self._true = now, wrench
        in_flight = self._in_flight
        while in_flight and in_flight[0][0] <= now + 1e-9:
            _, datagram, to = in_flight.popleft()
            if not self.faults.mute:
                self._end.send(datagram, to)

    def reboot(self) -> None:
        """Switch the box off and on, which clears its counter, bias and stream."""
        self._first_count = -round(self._now / self._period) * self.settings.divisor
        self._in_flight.clear()
        self._power_up()

    def page(self) -> bytes | None:
        """Return the box's page `netftapi2.xml`; None if the box is mute."""
        if self.faults.mute:
            return None
        box, (_, _, status, *counts) = (
            self.settings,
            RECORD.unpack(self._read(0, self._now, self._true, self._true, 1.0)),
        )
        ranges = [box.force_range] * 3 + [box.torque_range] * 3
        elements = {
            "runstat": f"0x{status:08X}",
            "runft": _array(counts),
            "runsg": _array([0] * 6),
            "prodname": box.product,
            "setbias": _array([round(bias * scale) for bias, scale in self._axes[5:].T.tolist()]),
            "cfgnam": box.serial,
            "cfgcalsn": box.serial,
            "cfgfu": "2",
            "scfgfu": "N",
            "cfgtu": "3",
            "scfgtu": "N-m",
            "cfgcpf": str(box.force_counts),
            "cfgcpt": str(box.torque_counts),
            "cfgmr": _array([f"{value:g}" for value in ranges]),
            "netip": box.address,
            "comrdte": "Enabled",
            "comrdtrate": str(round(COUNTER_RATE_HZ / box.divisor)),
            "comrdtbsiz": "10",
        }
        body = "".join(f"<{name}>{text}</{name}>\n" for name, text in elements.items())
        return f'<?xml version="1.0"?>\n<netft>\n{body}</netft>\n'.encode()

    def _power_up(self) -> None:
        self._axes[5] = 0.0
        self._client: Address | None = None
        self._stream_start = 0.0
        self._left = 0  # number of records still to send; 0: send until stopped
        self._sequence = 0
        self._record: bytes | None = None  # the newest record

    def _handle_request(self, datagram: bytes, sender: Address) -> None:
        """Process a request; ignore a datagram that is no request, as the box does."""
        if len(datagram) != REQUEST.size:
            return
        header, command, samples = REQUEST.unpack(datagram)
        if header != HEADER:
            return
        if command == RdtCommand.STREAM:
            self._in_flight.clear()  # a real box would receive the request before it sends these records
            self._client, self._stream_start, self._left = sender, self._now + self.settings.first, samples
            self._sequence = 0
        elif command == RdtCommand.STOP:
            self._in_flight.clear()
            self._client = None
        elif command == RdtCommand.BIAS:
            counts = RECORD.unpack(self._read(0, self._now, self._true, self._true, 1.0))[3:]
            self._axes[5] += np.array(counts) / self._axes[6]

    def _read(self, sequence: int, time: float, before: Array, after: Array, part: float) -> bytes:
        """Return the record of the wrench that is interpolated between `before` and `after` (6,) with weight `part`."""
        if self._drawn == NOISE_BLOCK:
            self._noise, self._drawn = self._rng.standard_normal((NOISE_BLOCK, 6)), 0
        counter = (self._first_count + self._next * self._divisor) % SEQUENCE_WRAP
        faults, record = self.faults, self._bytes
        _encode_record(
            self._axes, self._noise, self._drawn, time, before, after, part, faults.saturate,
            sequence, counter, faults.status, record,
        )  # fmt: skip
        self._drawn += 1
        return record.tobytes()

    def _measure(self, time: float, before: Array, after: Array, part: float) -> None:
        """Measure and send one record of the stream."""
        sequence = self._sequence = (self._sequence + 1) % SEQUENCE_WRAP
        if not self.faults.freeze or self._record is None:
            self._record = self._read(sequence, time, before, after, part)
        else:
            self._record = sequence.to_bytes(4, "big") + self._record[4:]
        self._send(time, self._record)
        if self._left == 1:
            self._client = None
        if self._left:
            self._left -= 1

    def _send(self, time: float, datagram: bytes) -> None:
        """Send a datagram, to which the transmission faults are applied."""
        faults, chance = self.faults, self._chance
        if self._client is None or (faults.drop and chance.random() < faults.drop):
            return
        if faults.flip and chance.random() < faults.flip:
            bit = int(chance.integers(8 * len(datagram)))
            corrupted = bytearray(datagram)
            corrupted[bit // 8] ^= 1 << bit % 8
            datagram = bytes(corrupted)
        item = (time + self.settings.latency + faults.delay, datagram, self._client)
        if faults.reorder and self._swapped is None and chance.random() < faults.reorder:
            self._swapped = item
            return
        self._in_flight.append(item)
        if faults.duplicate and chance.random() < faults.duplicate:
            self._in_flight.append(item)
        if self._swapped is not None:
            self._in_flight.append((item[0], *self._swapped[1:]))
            self._swapped = None


def gain_errors(bound: float, box: BoxSettings, rng: np.random.Generator) -> Array:
    """Return random errors of gain and cross-talk (6, 6); relative to the axes' ranges, they are within +-`bound`."""
    ranges = np.repeat([box.force_range, box.torque_range], 3)
    return bound * rng.uniform(-1.0, 1.0, (6, 6)) * ranges[:, None] / ranges


@compiled
def _encode_record(
    axes: Array, noise: Array, row: int, time: float, before: Array, after: Array, part: float, saturate: bool,
    sequence: int, counter: int, status: int, record: Octets,
) -> None:  # fmt: skip
    """Encode the record of the wrench between `before` and `after`; `axes` are the rows of `SimulatedNetft._axes`."""
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
