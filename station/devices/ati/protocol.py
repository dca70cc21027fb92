"""Protocol of ATI Net F/T boxes, raw data transfer (RDT) by UDP: records, their sequence and status; without I/O.

A record has no checksum except that of UDP. A wrong record is detected by the length of its datagram, by its two
counters, which increase together, and by the clock. All numbers in datagrams are big-endian.
Sources: Net F/T manual 9620-05 for layouts and rates; public clients for the status bits.
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.robot.robot import Array, Indices
from station.devices.kernel.sampled import SampleClock, latest, observe

SAMPLE_RATE_HZ = 7000.0  #: rate of the box's internal counter, +-0.5 % [1/s]
LATENCY_S = 288e-6  #: time from a measurement until the box sends its record on the Ethernet [s]
#: Largest drift of the box's clock that `SampleClock` assumes [s/s]: above the box's largest error of 0.5 %.
MAX_CLOCK_DRIFT = 0.006

RDT_PORT = 49152  #: UDP port of a box

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">IIIiiiiii")
SEQUENCE_WRAP = 1 << 32

#: Status words of a box without a fault, and of a box with only a latched monitor condition.
HEALTHY = 0x00000000
THRESHOLD_LATCHED = 0x80010000
ERROR_SUMMARY = 1 << 31
SATURATED = 1 << 17

STATUS_BITS = {
    30: "CPU or RAM",
    29: "digital board",
    28: "analog board",
    27: "serial link between the boards",
    26: "program memory",
    25: "halted, configuration",
    24: "settings not valid",
    23: "configuration does not fit the calibration",
    22: "network",
    21: "CAN",
    20: "RDT",
    19: "EtherNet/IP",
    18: "DeviceNet",
    17: "transducer saturated or A/D",
    16: "monitor condition latched",
    14: "watchdog",
    13: "stack",
    12: "EEPROM",
    11: "flash",
    10: "analog watchdog",
    9: "excitation current high",
    8: "excitation current low",
    7: "analog ground",
    6: "analog supply high",
    5: "analog supply low",
    4: "serial data unavailable",
    3: "reference or power",
    2: "temperature",
    1: "HTTP",
}

#: Smallest usable rate of the records [1/s], and the largest number of internal samples between two records.
MIN_RECORD_RATE_HZ, MAX_STEP_SAMPLES = 50, 140
#: Largest number of samples by which a record's counter may be ahead of the clock's estimate (jitter of the transport).
MAX_AHEAD_SAMPLES = 140
#: Number of consistent, evenly spaced records that start a stream, and number that replace it by another sequence.
RECORDS_TO_START, RECORDS_TO_REPLACE = 3, 10
#: If a counter differs from the expected one by more than this time, the box was restarted or replaced [s].
RESET_AFTER_S = 0.5


class RdtCommand(IntEnum):
    """Commands to the box; a stream request also ends the present stream, even that of another client."""

    STOP = 0x0000
    STREAM = 0x0002  #: one record per datagram
    BIAS = 0x0042


class RdtSample(NamedTuple):
    """A record that is consistent with the stream."""

    time: float  #: time of the measurement, host clock [s]
    status: int
    counts: tuple[int, ...]  #: Fx Fy Fz Tx Ty Tz [counts]


@dataclass
class Counters:
    """Counters of a stream since its creation."""

    accepted: int = 0  #: records accepted
    lost: int = 0  #: records missing in the sequence
    duplicates: int = 0  #: records received again
    late: int = 0  #: records that arrived after a newer record and were dropped
    malformed: int = 0  #: datagrams of a wrong length
    implausible: int = 0  #: records with an impossible counter that were dropped
    resyncs: int = 0  #: how many times another sequence replaced the present one
    resets: int = 0  #: restarts of the sample counter: the box has lost its bias, or was replaced


def request(command: RdtCommand, samples: int = 0) -> bytes:
    """Return the 8 bytes of a command; `samples` is the number of records (0: until stopped)."""
    return REQUEST.pack(HEADER, command, samples)


def is_usable(status: int) -> bool:
    """Return whether a status has no fault; a latched monitor condition is only a warning."""
    return status in (HEALTHY, THRESHOLD_LATCHED)


def describe(status: int) -> str:
    """Return the set bits of a status word as text."""
    if status == HEALTHY:
        return "healthy"
    named = [STATUS_BITS.get(bit, f"bit {bit}") for bit in range(30, -1, -1) if status >> bit & 1]
    return ", ".join(named) or "error summary alone"


RDT, FT, COUNT, STEP, ACCEPTED, CONSISTENT, STARTED = range(7)  #: indices in the state array of a stream


@compiled
def follow(stream: Indices, clock: Array, datagram: bytes, now: float, limits: Array, row: Array) -> bool:
    """Process a normal datagram: one record, next in sequence, healthy, and inside `limits` (6,) [counts].

    Write the record's time [s] and counts to `row` (7,). For any other datagram return False, without a change of the
    stream; `row` may be overwritten.
    """
    step = stream[STEP]
    if not stream[STARTED] or not step or len(datagram) != 36:
        return False
    rdt, ft, count = (stream[RDT] + 1) % SEQUENCE_WRAP, (stream[FT] + step) % SEQUENCE_WRAP, stream[COUNT] + step
    head = (rdt, ft, HEALTHY)
    for k in range(3):
        if word(datagram, 4 * k) != head[k]:
            return False
    if count > latest(clock, now) + MAX_AHEAD_SAMPLES:
        return False
    for k in range(6):
        counts = word(datagram, 12 + 4 * k)
        if counts >= SEQUENCE_WRAP // 2:
            counts -= SEQUENCE_WRAP
        if not -limits[k] <= counts <= limits[k]:
            return False
        row[1 + k] = counts
    stream[RDT], stream[FT], stream[COUNT], stream[CONSISTENT] = rdt, ft, count, 0
    stream[ACCEPTED] += 1
    row[0] = observe(clock, count, now)
    return True


@compiled
def word(data: bytes, at: int) -> int:
    """Return the unsigned number in four bytes from index `at` on, most significant byte first."""
    return data[at] << 24 | data[at + 1] << 16 | data[at + 2] << 8 | data[at + 3]


class Stream:
    """The records of one box in order; the stream counts and drops inconsistent records."""

    def __init__(self, latency: float = LATENCY_S, requested: float = math.inf) -> None:
        """`latency`: usual delay of a record [s]; `requested`: time of the first request [s]; inf: unknown."""
        self._latency, self._requested = latency, requested
        self.clock = self._new_clock()
        self._late = 0.0  # largest possible delay of the clock's first record [s]
        #: State for compiled code. RDT, FT: numbers of the last record; COUNT: its FT number without wrap-around; STEP:
        #: internal samples per record, 0 if not evenly spaced; ACCEPTED: number of accepted records; CONSISTENT: number
        #: of mutually consistent records outside the sequence; STARTED: whether the last request has had a record.
        self._state = np.zeros(7, dtype=np.int64)
        self._out_of_order: tuple[int, ...] | None = None  # the last record outside the sequence
        self._candidate = self._slow = 0.0  # internal samples per record: of a new stream, and of one that is too slow
        self._counters = Counters()

    def _new_clock(self) -> SampleClock:
        return SampleClock(SAMPLE_RATE_HZ, MAX_CLOCK_DRIFT, self._latency, SEQUENCE_WRAP)

    @property
    def record_rate(self) -> float | None:
        """Rate at which the box sends records [1/s]; None: unknown."""
        step = self._slow or float(self._state[STEP])
        return SAMPLE_RATE_HZ / step if step else None

    @property
    def counters(self) -> Counters:
        """Counters so far."""
        self._counters.accepted = int(self._state[ACCEPTED])
        return self._counters

    def restart(self) -> None:
        """Prepare for a new stream request, after which the box numbers its records from 1 again."""
        self._state[STARTED] = self._state[CONSISTENT] = 0
        self._out_of_order = None

    @property
    def state(self) -> tuple[Indices, Array]:
        """State arrays of the stream and of its clock, for `follow`; a reset of the box replaces the clock's array."""
        return self._state, self.clock.state

    def feed(self, datagram: bytes, now: float) -> list[RdtSample]:
        """Process a datagram that has arrived by `now` [s]; return its consistent samples."""
        if not datagram or len(datagram) % RECORD.size:
            self._counters.malformed += 1
            return []
        samples: list[RdtSample] = []
        for fields in RECORD.iter_unpack(datagram):
            sample = self._take(fields, now)
            if sample is not None:
                samples.append(sample)
        return samples

    def _take(self, fields: tuple[int, ...], now: float) -> RdtSample | None:
        rdt, ft, last, step, _, _, started = self._state.tolist()
        if started:
            steps = fields[0] - rdt & SEQUENCE_WRAP - 1
            samples = fields[1] - ft & SEQUENCE_WRAP - 1
            if steps and (samples == step * steps if step else steps <= samples <= MAX_STEP_SAMPLES * steps):
                count = last + samples
                if count <= self.clock.latest(now) + MAX_AHEAD_SAMPLES:
                    self._counters.lost += steps - 1
                    return self._accept(fields, count, now)
            if steps == 0:
                self._counters.duplicates += 1
                return None
            if steps > SEQUENCE_WRAP // 2:
                self._counters.late += 1
            else:
                self._counters.implausible += 1
        return self._consider(fields, now)

    def _accept(self, fields: tuple[int, ...], count: int, now: float) -> RdtSample:
        state = self._state
        state[RDT], state[FT], state[COUNT], state[STARTED], state[CONSISTENT] = fields[0], fields[1], count, 1, 0
        state[ACCEPTED] += 1
        self._out_of_order, self._slow = None, 0.0
        return RdtSample(self.clock.observe(count, now), fields[2], fields[3:])

    def _consider(self, fields: tuple[int, ...], now: float) -> RdtSample | None:
        """Restart the stream at this record if enough records outside the sequence are mutually consistent."""
        before, self._out_of_order = self._out_of_order, fields
        ratio, started = _ratio(before, fields), bool(self._state[STARTED])
        if ratio > MAX_STEP_SAMPLES:
            self._candidate, self._slow = ratio, ratio if ratio == self._candidate else 0.0
            self._state[CONSISTENT] = 1
            return None
        consistent = int(self._state[CONSISTENT]) + 1 if ratio else 1
        self._state[CONSISTENT] = consistent
        self._candidate = ratio if consistent == 2 or ratio == self._candidate else 0.0
        if consistent < (RECORDS_TO_START if not started and self._candidate else RECORDS_TO_REPLACE):
            return None
        self._counters.resyncs += started
        self._state[STEP] = int(self._candidate) if self._candidate == int(self._candidate) else 0
        count = fields[1]
        if self.clock.is_set:
            count = self.clock.unwrapped(count, now)
            off = count - round(self.clock.latest(now))
            # The first record may have waited, for instance on a busy computer; the clock is then late by that time.
            late = self._late if off > 0 else 0.0
            if abs(off) / SAMPLE_RATE_HZ > RESET_AFTER_S + self.clock.doubt(now) + late:
                count = fields[1]
                self._counters.resets += 1
                self.clock = self._new_clock()
        else:
            self._late = max(0.0, now - self._requested)
        return self._accept(fields, count, now)


def _ratio(before: tuple[int, ...] | None, after: tuple[int, ...]) -> float:
    """Return the internal samples per record between two records; 0 if the second cannot follow the first."""
    if before is None:
        return 0.0
    steps = after[0] - before[0] & SEQUENCE_WRAP - 1
    samples = after[1] - before[1] & SEQUENCE_WRAP - 1
    return samples / steps if steps and steps <= samples else 0.0


#: Samples stored per sensor: those of several ticks at the highest record rate.
HISTORY_SAMPLES = 64


class SampleHistory:
    """A ring buffer of samples for each sensor."""

    def __init__(self, scale: Array) -> None:
        """`scale` (q, 6) is the force or moment per count [N, N m]."""
        self.rows = np.zeros((len(scale), HISTORY_SAMPLES, 7))  #: time [s] and six counts
        self._scale = scale
        self._ends = np.zeros((len(scale), 2), dtype=np.int64)  # index of the newest row, number of rows

    def ring(self, sensor: int) -> "SampleRing":
        """Return the ring buffer of one sensor."""
        return SampleRing(self.rows[sensor], self._ends[sensor])

    def at(self, time: float) -> Array:
        """Return wrenches (q, 6) at `time` [s], linearly interpolated; every sensor needs at least one sample."""
        wrenches = np.empty(self._scale.shape)
        _at(self.rows, self._ends, time, self._scale, wrenches)
        return wrenches


class SampleRing:
    """The ring buffer of one sensor, with times that never decrease."""

    def __init__(self, rows: Array, ends: Indices) -> None:
        self.row = np.zeros(7)  #: the sample that `push` appends next: time [s] and six counts
        self.time = -math.inf  #: time of the newest sample; minus infinity: no sample [s]
        self.rows, self.ends = rows, ends

    def push(self) -> None:
        """Append `row`. Its time is raised to the newest one if a correction of the clock has made it earlier."""
        self.time = push(self.rows, self.ends, self.row, self.time)

    def clear(self) -> None:
        """Delete all samples."""
        self.ends[1], self.time = 0, -math.inf


@compiled
def push(rows: Array, ends: Indices, row: Array, time: float) -> float:
    """Compiled code of `SampleRing.push`: append `row` to the ring's arrays, and return the newest sample's time."""
    ends[0], ends[1] = (ends[0] + 1) % HISTORY_SAMPLES, min(ends[1] + 1, HISTORY_SAMPLES)
    time = max(time, row[0])
    copy(row, rows[ends[0]])
    rows[ends[0], 0] = time
    return time


@compiled
def _at(rows: Array, ends: Indices, time: float, scale: Array, wrenches: Array) -> None:
    for i in range(scale.shape[0]):
        after = before = ends[i, 0]
        for _ in range(ends[i, 1] - 1):
            if rows[i, before, 0] <= time:
                break
            after, before = before, (before - 1) % HISTORY_SAMPLES
        start, end = rows[i, before, 0], rows[i, after, 0]
        part = (time - start) / (end - start) if start < time < end else (1.0 if time >= end else 0.0)
        for k in range(6):
            a, b = rows[i, before, 1 + k], rows[i, after, 1 + k]
            wrenches[i, k] = scale[i, k] * (a + part * (b - a))
