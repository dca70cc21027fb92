"""Simulated Zaber T-series units on one chain, at wire level: their serial line, addressing and faults.

The line between the units and the host carries 9600 baud in both directions. This module simulates the transmission
times, because a pty or a socket does not limit the baud rate.
Sources: the manufacturer's Binary Protocol Manual and the T-Series pages of its wiki. Times that these sources do not
specify are parameters.
"""

import math
import random
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from station.devices.links.link import Link
from station.devices.zaber.protocol import (
    BYTE_TIME_S,
    MESSAGE_BYTES,
    RESYNC_GAP_S,
    ZaberCommand,
    ZaberMessage,
    decode,
    encode,
)
from station.lab.wires import BUFFER_BYTES
from station.lab.zaber_unit import Unit

RENUMBER_TIME_S = 0.5  #: time after Renumber in which the units ignore commands [s]
ALIAS = int(ZaberCommand.SET_ALIAS)


class Faults(NamedTuple):
    """Faults of the chain; a slot is a unit's position on the chain, and slot 1 is nearest to the computer."""

    drop: float = 0.0  #: probability that a byte is lost, in both directions
    flip: float = 0.0  #: probability that one bit of a byte is inverted, in both directions
    delay: float = 0.0  #: delay of every reply [s]
    mute: frozenset[int] = frozenset()  #: slots whose replies are lost
    cut: int | None = None  #: slot from which on nothing is transmitted in either direction; 1: the whole line
    stalled: frozenset[int] = frozenset()  #: slots whose motors stand still although their step counters advance


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


class Waiting(NamedTuple):
    """Bytes that the line transmits one after the other."""

    start: float  #: time at which the transmission of the first byte starts [s]
    data: bytes


class PacedLine:
    """The line from the units to the host, with the transmission time of each byte."""

    def __init__(self, byte_time: float = BYTE_TIME_S) -> None:
        """`byte_time` is the transmission time of a byte [s]."""
        self._byte_time = byte_time
        self._free = -math.inf
        self._waiting: deque[Waiting] = deque()

    def put(self, data: bytes, now: float) -> None:
        """Send bytes at `now` [s] or as soon as the line is free; bytes beyond the buffer's size are lost."""
        start = max(self._free, now)
        data = data[: free_buffer(start - now, self._byte_time)]
        self._free = start + len(data) * self._byte_time
        self._waiting.append(Waiting(start, data))

    def take(self, until: float) -> bytes:
        """Return the bytes that the line has transmitted until the time `until` [s]."""
        carried = b""
        if not self._waiting or self._waiting[0].start > until:
            return carried
        while self._waiting:
            start, data = self._waiting[0]
            count = int((until - start) / self._byte_time + 1e-6)
            if count < len(data):
                if count > 0:
                    carried += data[:count]
                    self._waiting[0] = Waiting(start + count * self._byte_time, data[count:])
                break
            carried += data
            self._waiting.popleft()
        return carried


class ReceivedLine:
    """The line from the host to the units: complete messages, each with the arrival time of its last byte."""

    def __init__(self) -> None:
        self.messages: deque[tuple[float, ZaberMessage]] = deque()
        self._free = self._last = self._deaf_until = -math.inf
        self._part = b""

    def put(self, data: bytes, now: float) -> None:
        """Receive bytes that the host sends, from `now` [s] or as soon as the line is free.

        Bytes beyond the size of the host's buffer are lost. A message with a pause of more than 10 ms is dropped, as
        real units do.
        """
        time = max(self._free, now)
        data = data[: free_buffer(time - now)]
        self._free = time + len(data) * BYTE_TIME_S
        while data:
            if time + BYTE_TIME_S < self._deaf_until:
                time, data = time + BYTE_TIME_S, data[1:]
                continue
            if time + BYTE_TIME_S - self._last > RESYNC_GAP_S:
                self._part = b""
            taken = data[: MESSAGE_BYTES - len(self._part)]
            data = data[len(taken) :]
            self._part += taken
            self._last = time = time + len(taken) * BYTE_TIME_S
            if len(self._part) == MESSAGE_BYTES:
                message, self._part = decode(self._part), b""
                self.messages.append((time, message))
                if message.device == 0 and message.command == ZaberCommand.RENUMBER:
                    self._deaf_until = time + RENUMBER_TIME_S


def free_buffer(backlog: float, byte_time: float = BYTE_TIME_S) -> int:
    """Return the free bytes of a port's buffer whose content takes `backlog` [s] to transmit."""
    return max(0, BUFFER_BYTES - math.ceil(backlog / byte_time))


class SimulatedChain:
    """Units on one line, the nearest to the computer first."""

    def __init__(self, units: Sequence[Unit], seed: int = 0, processing: float = 0.0) -> None:
        """`processing` is the time from the last byte of a command to the first byte of its reply [s]."""
        self.units = tuple(units)
        self.time = 0.0
        self._processing = processing
        self.noise = LineNoise(seed)
        self._in, self._out = ReceivedLine(), PacedLine()
        self._faults = Faults()

    @property
    def faults(self) -> Faults:
        """Active faults of the chain."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for slot, unit in enumerate(self.units, 1):
            unit.stall(slot in faults.stalled)

    @property
    def true_positions(self) -> list[float]:
        """True position of each stage from its home sensor's zero [microsteps]."""
        return [unit.true_position for unit in self.units]

    def power_cycle(self, slot: int) -> None:
        """Switch one unit off and on."""
        self.units[slot - 1].execute(ZaberMessage(0, ZaberCommand.RESET, 0))

    def turn_knob(self, slot: int, microsteps: float) -> None:
        """Turn the knob of one unit."""
        for message in self.units[slot - 1].turn_knob(microsteps):
            self._send(slot, message, self.time)

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]."""
        if data and self._faults.cut != 1:
            self._in.put(self.noise.damage(data, self._faults), now)

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        incoming = self._in.messages
        while incoming and incoming[0][0] <= now + 1e-9:
            time, message = incoming.popleft()
            self._run(time)
            self._deliver(message, time)
        self._run(now)
        data = self._out.take(now)
        return data if self._faults.cut != 1 else b""

    def _run(self, until: float) -> None:
        outgoing: list[tuple[float, int, ZaberMessage]] = []
        for slot, unit in enumerate(self.units, 1):
            if unit.due > until:
                unit.time = until
            else:
                outgoing += [(time, slot, message) for time, message in unit.advance(until)]
        if outgoing:
            for time, slot, message in sorted(outgoing):
                self._send(slot, message, time)
        self.time = until

    def _deliver(self, message: ZaberMessage, now: float) -> None:
        device = message.device
        to_all = device == 0
        cut = self._faults.cut
        for slot, unit in enumerate(self.units, 1):
            if cut is not None and slot >= cut:
                return
            if device not in (0, unit.number, unit.settings[ALIAS]) or now < unit.deaf_until:
                continue
            order = message
            if to_all and message.command == ZaberCommand.RENUMBER:
                order = message._replace(data=slot)
            for reply in unit.execute(order):
                self._send(slot, reply, now + self._processing)

    def _send(self, slot: int, message: ZaberMessage, now: float) -> None:
        faults = self._faults
        if slot not in faults.mute and (faults.cut is None or slot < faults.cut):
            self._out.put(self.noise.damage(encode(message), self._faults), now + faults.delay)


class LineDevices(Protocol):
    """Devices on one serial line."""

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]."""
        ...

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        ...


def pump(link: Link, chain: LineDevices, now: float, written: float | None = None) -> None:
    """Transmit bytes between a link (a pipe in memory, a pty or a socket) and the chain until `now` [s].

    In virtual time `written` is the time at which the link's bytes were written; in real time they count as
    written now.
    """
    data = link.read()
    if data:
        chain.receive(data, now if written is None else written)
    data = chain.advance(now)
    if data:
        link.write(data)
