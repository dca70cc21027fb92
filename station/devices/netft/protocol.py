"""ATI Net F/T, raw data transfer (RDT) over UDP port 49152: requests, records, sequence and status; sans-I/O.

A record has no checksum of its own (UDP has one): the length of its datagram, its two counters, which
run together, and the clock are what a wrong one is known by. All numbers on the wire are big-endian.
Layouts and rates: Net F/T manual 9620-05; status bits: as public clients read them.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array, Indices
from station.devices.netft.clock import LATENCY, SAMPLE_RATE, SampleClock, latest, observe

RDT_PORT = 49152

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">IIIiiiiii")
WRAP = 1 << 32

#: What a box with nothing wrong says, and what it says when only a monitor condition has latched.
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

#: Two records in a row are at most this many internal samples apart: the slowest stream has 50 records/s.
LONGEST_STEP = 140
#: A record may seem to come from the future by this many samples: jitter of the way here.
AHEAD = 140
#: So many records in line with one another begin a stream, if evenly spaced; or replace one that has gone elsewhere.
BEGIN, REPLACE = 3, 10
#: After a pause a counter that is off by more than this has started anew: another box, or the same after a reset [s].
RESET = 0.5


class Command(IntEnum):
    """What can be asked of the box; a new stream request overrides the last one, from whoever it comes."""

    STOP = 0x0000
    STREAM = 0x0002  #: one record a datagram
    STREAM_BUFFERED = 0x0003  #: several records a datagram
    RESET_LATCH = 0x0041
    BIAS = 0x0042


class Record(NamedTuple):
    """One record as it came."""

    rdt_sequence: int  #: from 1 in each stream request
    ft_sequence: int  #: the box's internal sample counter
    status: int
    counts: tuple[int, ...]  #: Fx Fy Fz Tx Ty Tz


class Sample(NamedTuple):
    """A record that is in line with the stream."""

    time: float  #: when it was measured, host time [s]
    status: int
    counts: tuple[int, ...]  #: Fx Fy Fz Tx Ty Tz


class Counters(NamedTuple):
    """What a stream has seen since it was made."""

    accepted: int = 0
    lost: int = 0  #: missing in the sequence
    duplicates: int = 0
    late: int = 0  #: came after a newer one, dropped
    malformed: int = 0  #: datagrams of a wrong length
    implausible: int = 0  #: counters that cannot be, dropped
    resyncs: int = 0  #: another sequence had to be taken up
    resets: int = 0  #: the sample counter began anew: the box has lost its bias, or is another one


def request(command: Command, samples: int = 0) -> bytes:
    """The 8 bytes that ask for `samples` records (0: until stopped) or for what else `command` says."""
    return REQUEST.pack(HEADER, command, samples)


def records(datagram: bytes) -> list[Record] | None:
    """Records of a datagram; None if its length is not that of whole records."""
    if not datagram or len(datagram) % RECORD.size:
        return None
    return [Record(fields[0], fields[1], fields[2], fields[3:]) for fields in RECORD.iter_unpack(datagram)]


def is_usable(status: int) -> bool:
    """Whether nothing is wrong but perhaps a latched monitor condition, a mere warning."""
    return status in (HEALTHY, THRESHOLD_LATCHED)


def describe(status: int) -> str:
    """The set bits of a status word, for a person."""
    if status == HEALTHY:
        return "healthy"
    named = [STATUS_BITS.get(bit, f"bit {bit}") for bit in range(30, -1, -1) if status >> bit & 1]
    return ", ".join(named) or "error summary alone"


RDT, FT, COUNT, STEP, ACCEPTED, IN_LINE, BEGUN = range(7)  #: in the state of a stream


@compiled
def follow(stream: Indices, clock: Array, datagram: bytes, now: float, limits: Array, row: Array) -> bool:
    """Take the usual datagram: one record, the one that is to come next, healthy and inside `limits` (6,) [counts].

    `row` (7,) receives its time [s] and counts. False: it is anything else; nothing has happened.
    """
    step = stream[STEP]
    if not stream[BEGUN] or not step or len(datagram) != 36:
        return False
    rdt, ft, count = (stream[RDT] + 1) % WRAP, (stream[FT] + step) % WRAP, stream[COUNT] + step
    head = (rdt, ft, HEALTHY)
    for k in range(3):
        if word(datagram, 4 * k) != head[k]:
            return False
    if count > latest(clock, now) + AHEAD:
        return False
    for k in range(6):
        counts = word(datagram, 12 + 4 * k)
        if counts >= WRAP // 2:
            counts -= WRAP
        if not -limits[k] <= counts <= limits[k]:
            return False
        row[1 + k] = counts
    stream[RDT], stream[FT], stream[COUNT], stream[IN_LINE] = rdt, ft, count, 0
    stream[ACCEPTED] += 1
    row[0] = observe(clock, count, now)
    return True


@compiled
def word(data: bytes, at: int) -> int:
    """Four bytes, the most significant one first."""
    return data[at] << 24 | data[at + 1] << 16 | data[at + 2] << 8 | data[at + 3]


class Stream:
    """The records of one box, in order; whatever is not in line is counted and dropped."""

    def __init__(self, latency: float = LATENCY) -> None:
        self._latency = latency
        self._clock = SampleClock(latency)
        #: For compiled code: both sequences of the last record; the second unwrapped; internal samples from one record
        #: to the next, if those that began the stream agree, or 0; records accepted; how many that are not in line
        #: follow one another; whether there is a last record.
        self._state = np.zeros(7, dtype=np.int64)
        self._out_of_order: tuple[int, ...] | None = None  # the last one that was not in line
        self._candidate = 0.0
        self.lost = 0  #: records missing in the sequence so far
        self.resets = 0  #: how often the box's sample counter has begun anew
        self._duplicates = self._late = self._malformed = self._implausible = self._resyncs = 0

    @property
    def counters(self) -> Counters:
        """What has been seen so far."""
        return Counters(
            int(self._state[ACCEPTED]),
            self.lost,
            self._duplicates,
            self._late,
            self._malformed,
            self._implausible,
            self._resyncs,
            self.resets,
        )

    def restart(self) -> None:
        """A new request is sent: its sequence begins at 1."""
        self._state[BEGUN] = self._state[IN_LINE] = 0
        self._out_of_order = None

    @property
    def state(self) -> tuple[Indices, Array]:
        """Its numbers and its clock's, for `follow`; another clock after a reset."""
        return self._state, self._clock.state

    def feed(self, datagram: bytes, now: float) -> list[Sample]:
        """Take a datagram that has arrived by `now` [s]; give the samples in it that are in line."""
        if not datagram or len(datagram) % RECORD.size:
            self._malformed += 1
            return []
        samples: list[Sample] = []
        for fields in RECORD.iter_unpack(datagram):
            sample = self._take(fields, now)
            if sample is not None:
                samples.append(sample)
        return samples

    def _take(self, fields: tuple[int, ...], now: float) -> Sample | None:
        rdt, ft, last, step, _, _, begun = self._state.tolist()
        if begun:
            steps = fields[0] - rdt & WRAP - 1
            samples = fields[1] - ft & WRAP - 1
            if steps and (samples == step * steps if step else steps <= samples <= LONGEST_STEP * steps):
                count = last + samples
                if count <= self._clock.latest(now) + AHEAD:
                    self.lost += steps - 1
                    return self._accept(fields, count, now)
            if steps == 0:
                self._duplicates += 1
                return None
            if steps > WRAP // 2:
                self._late += 1
            else:
                self._implausible += 1
        return self._consider(fields, now)

    def _accept(self, fields: tuple[int, ...], count: int, now: float) -> Sample:
        state = self._state
        state[RDT], state[FT], state[COUNT], state[BEGUN], state[IN_LINE] = fields[0], fields[1], count, 1, 0
        state[ACCEPTED] += 1
        self._out_of_order = None
        return Sample(self._clock.observe(count, now), fields[2], fields[3:])

    def _consider(self, fields: tuple[int, ...], now: float) -> Sample | None:
        """Begin with this record if enough of those that are not in line are in line with one another."""
        before, self._out_of_order = self._out_of_order, fields
        ratio, begun = _ratio(before, fields), bool(self._state[BEGUN])
        in_line = int(self._state[IN_LINE]) + 1 if ratio else 1
        self._state[IN_LINE] = in_line
        self._candidate = ratio if in_line == 2 or ratio == self._candidate else 0.0
        if in_line < (BEGIN if not begun and self._candidate else REPLACE):
            return None
        self._resyncs += begun
        self._state[STEP] = int(self._candidate) if self._candidate == int(self._candidate) else 0
        count = fields[1]
        if self._clock.is_set:
            expected = round(self._clock.latest(now))
            off = (count - expected + WRAP // 2) % WRAP - WRAP // 2
            if abs(off) / SAMPLE_RATE <= RESET + self._clock.doubt(now):
                count = expected + off
            else:
                self.resets += 1
                self._clock = SampleClock(self._latency)
        return self._accept(fields, count, now)


def _ratio(before: tuple[int, ...] | None, after: tuple[int, ...]) -> float:
    """Internal samples a record from one to the other; 0 if it cannot follow."""
    if before is None:
        return 0.0
    steps = after[0] - before[0] & WRAP - 1
    samples = after[1] - before[1] & WRAP - 1
    return samples / steps if steps and steps <= samples <= LONGEST_STEP * steps else 0.0
