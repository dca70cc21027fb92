"""Simulated Zaber T-series units on one chain, at wire level: the line, who hears what, and what goes wrong.

The line between the units and the host carries 9600 baud in both directions, which a pty or a socket does
not know. Sources: the manufacturer's Binary Protocol Manual and his wiki's T-Series pages; times that he
does not give can be changed.
"""

import math
import random
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from station.devices.links.link import Link
from station.devices.zaber.protocol import BYTE_TIME, GAP, SIZE, Command, Message, decode, encode
from station.lab.zaber.unit import Unit

RENUMBERING = 0.5  #: the units are deaf so long after Renumber [s]
ALIAS = int(Command.SET_ALIAS)
BUFFER = 4096  #: of a serial port, each way [bytes]


class Faults(NamedTuple):
    """What is wrong with the chain; places count from the computer, 1 is the nearest."""

    drop: float = 0.0  #: probability that a byte gets lost, either way
    flip: float = 0.0  #: probability that one bit of a byte is turned, either way
    delay: float = 0.0  #: of every reply [s]
    mute: frozenset[int] = frozenset()  #: places whose replies do not come
    cut: int | None = None  #: from this place on nothing gets through, either way; 1: the whole line
    stalled: frozenset[int] = frozenset()  #: places whose motors count on and do not turn


class Waiting(NamedTuple):
    """Bytes that go over the line one after the other."""

    begin: float  #: of the first one [s]
    data: bytes


class PacedLine:
    """The line to the host: a byte takes its time, and they come one after the other."""

    def __init__(self) -> None:
        self._free = -math.inf
        self._waiting: deque[Waiting] = deque()

    def put(self, data: bytes, now: float) -> None:
        """Bytes to send, at `now` [s] or as soon as the line is free; what the buffer does not hold is lost."""
        begin = max(self._free, now)
        data = data[: room(begin - now)]
        self._free = begin + len(data) * BYTE_TIME
        self._waiting.append(Waiting(begin, data))

    def take(self, until: float) -> bytes:
        """Bytes that have been carried by then."""
        carried = b""
        if not self._waiting or self._waiting[0].begin > until:
            return carried
        while self._waiting:
            begin, data = self._waiting[0]
            count = int((until - begin) / BYTE_TIME + 1e-6)
            if count < len(data):
                if count > 0:
                    carried += data[:count]
                    self._waiting[0] = Waiting(begin + count * BYTE_TIME, data[count:])
                break
            carried += data
            self._waiting.popleft()
        return carried


class HeardLine:
    """The line to the units: whole messages, each when its last byte arrives."""

    def __init__(self) -> None:
        self.messages: deque[tuple[float, Message]] = deque()
        self._free = self._last = self._deaf_until = -math.inf
        self._part = b""

    def put(self, data: bytes, now: float) -> None:
        """Bytes that the host sends, from `now` [s] or as soon as the line is free; what its buffer does not hold
        is lost. A message with a silence of more than 10 ms inside is dropped, as the units do.
        """
        time = max(self._free, now)
        data = data[: room(time - now)]
        self._free = time + len(data) * BYTE_TIME
        while data:
            if time + BYTE_TIME < self._deaf_until:
                time, data = time + BYTE_TIME, data[1:]
                continue
            if time + BYTE_TIME - self._last > GAP:
                self._part = b""
            taken = data[: SIZE - len(self._part)]
            data = data[len(taken) :]
            self._part += taken
            self._last = time = time + len(taken) * BYTE_TIME
            if len(self._part) == SIZE:
                message, self._part = decode(self._part), b""
                self.messages.append((time, message))
                if message.device == 0 and message.command == Command.RENUMBER:
                    self._deaf_until = time + RENUMBERING


def room(backlog: float) -> int:
    """Bytes that go into a port's buffer from which others have so long to go [s]."""
    return max(0, BUFFER - math.ceil(backlog / BYTE_TIME))


class SimulatedChain:
    """Units on one line, the nearest to the computer first."""

    def __init__(self, units: Sequence[Unit], seed: int = 0, processing: float = 0.0) -> None:
        """`processing` is from the last byte of a command to the first of its reply [s]."""
        self.units = tuple(units)
        self.time = 0.0
        self._processing = processing
        self._random = random.Random(seed)  # noqa: S311 - noise, no secret
        self._in, self._out = HeardLine(), PacedLine()
        self._faults = Faults()

    @property
    def faults(self) -> Faults:
        """What is wrong with it at present."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for place, unit in enumerate(self.units, 1):
            unit.stall(place in faults.stalled)

    @property
    def places(self) -> list[float]:
        """Where each stage really is, from its home sensor's zero [microsteps]."""
        return [unit.place for unit in self.units]

    def power_cycle(self, place: int) -> None:
        """Switch one unit off and on."""
        self.units[place - 1].take(Message(0, Command.RESET, 0))

    def turn_knob(self, place: int, microsteps: float) -> None:
        """Somebody turns the knob of one unit."""
        for message in self.units[place - 1].turn_knob(microsteps):
            self._say(place, message, self.time)

    def receive(self, data: bytes, now: float) -> None:
        """Bytes that the host has written by `now` [s]."""
        if data and self._faults.cut != 1:
            self._in.put(self._damaged(data), now)

    def advance(self, now: float) -> bytes:
        """Let time pass; the bytes that have reached the host by `now` [s]."""
        heard = self._in.messages
        while heard and heard[0][0] <= now + 1e-9:
            time, message = heard.popleft()
            self._run(time)
            self._deliver(message, time)
        self._run(now)
        data = self._out.take(now)
        return data if self._faults.cut != 1 else b""

    def _run(self, until: float) -> None:
        said: list[tuple[float, int, Message]] = []
        for place, unit in enumerate(self.units, 1):
            if unit.due > until:
                unit.time = until
            else:
                said += [(time, place, message) for time, message in unit.advance(until)]
        for time, place, message in sorted(said):
            self._say(place, message, time)
        self.time = until

    def _deliver(self, message: Message, now: float) -> None:
        device = message.device
        to_all = device == 0
        cut = self._faults.cut
        for place, unit in enumerate(self.units, 1):
            if cut is not None and place >= cut:
                return
            if device not in (0, unit.number, unit.settings[ALIAS]) or now < unit.deaf_until:
                continue
            order = message
            if to_all and message.command == Command.RENUMBER:
                order = message._replace(data=place)
            for reply in unit.take(order):
                self._say(place, reply, now + self._processing)

    def _say(self, place: int, message: Message, now: float) -> None:
        faults = self._faults
        if place not in faults.mute and (faults.cut is None or place < faults.cut):
            self._out.put(self._damaged(encode(message)), now + faults.delay)

    def _damaged(self, data: bytes) -> bytes:
        """What the line makes of it."""
        drop, flip = self._faults.drop, self._faults.flip
        if drop == 0.0 and flip == 0.0:
            return data
        kept = [byte for byte in data if self._random.random() >= drop]
        return bytes(b ^ 1 << self._random.randrange(8) if self._random.random() < flip else b for b in kept)


def pump(link: Link, chain: SimulatedChain, now: float, written: float | None = None) -> None:
    """Carry bytes between a link and the chain until `now` [s]: a pipe in memory, a pty or a socket.

    In virtual time `written` says when the bytes were written that the link holds; in real time they are
    taken as written now.
    """
    data = link.read()
    if data:
        chain.receive(data, now if written is None else written)
    data = chain.advance(now)
    if data:
        link.write(data)
