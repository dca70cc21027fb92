"""The simulated serial line of stages with its faults, and the interfaces that all kinds of simulated stages share.

A pty or a socket does not limit the baud rate, so the simulation paces the bytes of both directions.
"""

import math
import random
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from station.devices.links.link import Link
from station.lab.motor import Motor
from station.lab.wires import BUFFER_BYTES


class Faults(NamedTuple):
    """Faults of the stages and their line; a slot is a stage's position on the line, and slot 1 is the nearest."""

    drop: float = 0.0  #: probability that a byte is lost, in both directions
    flip: float = 0.0  #: probability that one bit of a byte is inverted, in both directions
    delay: float = 0.0  #: delay of every reply [s]
    mute: frozenset[int] = frozenset()  #: slots whose replies are lost
    cut: int | None = None  #: first slot behind a cut of the cable, which carries nothing there; 1: the whole line
    stalled: frozenset[int] = frozenset()  #: slots whose motors do not move although their step counters advance
    clamped: frozenset[int] = frozenset()  #: slots whose motors and counters do not move although commands are accepted


class LineNoise:
    """The damage that a line with faults does to the bytes of both directions."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)  # noqa: S311 - noise, not a secret
        self.damaged = 0  #: number of bytes that were lost or changed

    def damage(self, data: bytes, faults: Faults) -> bytes:
        """Return the data without its lost bytes; some bytes have a flipped bit."""
        drop, flip = faults.drop, faults.flip
        if drop == 0.0 and flip == 0.0:
            return data
        kept = [byte for byte in data if self._random.random() >= drop]
        sent = bytes(b ^ 1 << self._random.randrange(8) if self._random.random() < flip else b for b in kept)
        self.damaged += len(data) - len(kept) + sum(a != b for a, b in zip(kept, sent, strict=True))
        return sent


class OutLine(Protocol):
    """The line from the devices to the host."""

    def put(self, data: bytes, now: float) -> None:
        """Send bytes at `now` [s] or as soon as the line is free; bytes beyond the buffer's size are lost."""
        ...

    def take(self, until: float) -> bytes:
        """Return the bytes that have arrived until the time `until` [s]."""
        ...


class PacedLine:
    """A line from the devices to the host, with the transmission time of each byte."""

    def __init__(self, byte_time: float) -> None:
        """`byte_time` is the transmission time of a byte [s]."""
        self._byte_time = byte_time
        self._free = -math.inf
        self._waiting: deque[tuple[float, bytes]] = deque()  # starts of transmission [s], and bytes

    def put(self, data: bytes, now: float) -> None:
        """Send bytes at `now` [s] or as soon as the line is free; bytes beyond the buffer's size are lost."""
        start = max(self._free, now)
        data = data[: free_buffer(start - now, self._byte_time)]
        self._free = start + len(data) * self._byte_time
        self._waiting.append((start, data))

    def take(self, until: float) -> bytes:
        """Return the bytes that the line has transmitted until the time `until` [s]."""
        carried = b""
        if not self._waiting or self._waiting[0][0] > until:
            return carried
        while self._waiting:
            start, data = self._waiting[0]
            count = int((until - start) / self._byte_time + 1e-6)
            if count < len(data):
                if count > 0:
                    carried += data[:count]
                    self._waiting[0] = (start + count * self._byte_time, data[count:])
                break
            carried += data
            self._waiting.popleft()
        return carried


def free_buffer(backlog: float, byte_time: float) -> int:
    """Return the free bytes of a port's buffer whose content takes `backlog` [s] to transmit."""
    return max(0, BUFFER_BYTES - math.ceil(backlog / byte_time))


class SimulatedUnit(Protocol):
    """One simulated stage."""

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [microsteps]."""
        ...


class SimulatedStages(Protocol):
    """The simulated stages of a bench on their line; a slot is a stage's number, counted from 1."""

    @property
    def faults(self) -> Faults:
        """Active faults of the stages and their line."""
        ...

    @faults.setter
    def faults(self, faults: Faults) -> None: ...

    @property
    def units(self) -> Sequence[SimulatedUnit]:
        """The stages in the robot's order."""
        ...

    @property
    def noise(self) -> LineNoise:
        """The damage that the line does to the bytes of both directions."""
        ...

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]."""
        ...

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        ...

    def power_cycle(self, slot: int) -> None:
        """Switch one stage off and on."""
        ...


def pump(link: Link, stages: SimulatedStages, now: float, written: float | None = None) -> None:
    """Transmit bytes between a link (a pipe in memory, a pty or a socket) and the stages until `now` [s].

    In virtual time `written` is the time at which the link's bytes were written; in real time they count as
    written now.
    """
    data = link.read()
    if data:
        stages.receive(data, now if written is None else written)
    data = stages.advance(now)
    if data:
        link.write(data)


class SimulatedAxis(SimulatedUnit, Protocol):
    """One simulated stage with its controller, which receives and sends messages of its protocol."""

    @property
    def motor(self) -> Motor:
        """Motor of the stage."""
        ...

    def switch_off_and_on(self) -> None:
        """Simulate a power cycle: the stage is at rest without a reference position."""
        ...

    def receive(self, command: Any, now: float, slot: int) -> Sequence[Any]:
        """Process a command that arrives at `now` [s] at the stage in this slot, and return the immediate answers."""
        ...

    def advance(self, until: float) -> Sequence[tuple[float, Any]]:
        """Run the motor until `until` [s]; return messages about the motion's end or failure, with their times."""
        ...


class SimulatedProtocol(Protocol):
    """Interface of a protocol's line: it decodes commands, encodes answers, and gives their times."""

    @property
    def out(self) -> OutLine:
        """The line to the host."""
        ...

    @property
    def processing(self) -> float:
        """Time from the end of a command to the start of its answer [s]."""
        ...

    def read(self, data: bytes, now: float) -> Iterable[tuple[float, Any]]:
        """Return the commands that bytes of the host complete, each with its time of arrival.

        Bytes instead of a command are an immediate answer of the host's adapter.
        """
        ...

    def encode(self, axis: Any, answer: Any, at: float) -> tuple[float, bytes]:
        """Return the time [s] at which an answer that an axis sends at `at` [s] is on the line, and its bytes."""
        ...


AxisT = TypeVar("AxisT", bound=SimulatedAxis)


class SimulatedLine(Generic[AxisT]):
    """Stages with a controller each on one line, the nearest to the computer first."""

    def __init__(self, protocol: SimulatedProtocol, units: Sequence[AxisT], seed: int = 0) -> None:
        self.units = tuple(units)
        self.time = 0.0
        self.noise = LineNoise(seed)
        self._protocol, self._faults = protocol, Faults()
        self._incoming: deque[tuple[float, Any]] = deque()  # times of arrival [s], and commands

    @property
    def faults(self) -> Faults:
        """Active faults of the stages and their line."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for slot, unit in enumerate(self.units, 1):
            unit.motor.stall(slot in faults.stalled)
            unit.motor.clamp(slot in faults.clamped)

    def power_cycle(self, slot: int) -> None:
        """Switch one stage off and on."""
        self.units[slot - 1].switch_off_and_on()

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]; bytes beyond the host's buffer are lost."""
        if not data or self._faults.cut == 1:
            return
        for time, command in self._protocol.read(self.noise.damage(data, self._faults), now):
            if isinstance(command, bytes):
                self._transmit(command, time)
            else:
                self._incoming.append((time, command))

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        while self._incoming and self._incoming[0][0] <= now + 1e-9:
            time, command = self._incoming.popleft()
            self._run(time)
            for slot, unit in enumerate(self.units, 1):
                if self._reaches(slot):
                    for answer in unit.receive(command, time, slot):
                        self.put(slot, answer, time + self._protocol.processing)
        self._run(now)
        data = self._protocol.out.take(now)
        return data if self._faults.cut != 1 else b""

    def put(self, slot: int, answer: Any, at: float) -> None:
        """Send a message of the stage in a slot at the time `at` [s]."""
        time, data = self._protocol.encode(self.units[slot - 1], answer, at)
        if slot not in self._faults.mute and self._reaches(slot):
            self._transmit(data, time)

    def _run(self, until: float) -> None:
        sent = [(time, slot, one) for slot, unit in enumerate(self.units, 1) for time, one in unit.advance(until)]
        for time, slot, answer in sorted(sent, key=lambda message: message[0]):
            self.put(slot, answer, time)
        self.time = until

    def _reaches(self, slot: int) -> bool:
        """Return whether the cable to a slot is not cut."""
        return self._faults.cut is None or slot < self._faults.cut

    def _transmit(self, data: bytes, at: float) -> None:
        self._protocol.out.put(self.noise.damage(data, self._faults), at + self._faults.delay)
