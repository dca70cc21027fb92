"""Damage to the bytes of any line or network: flipped, lost, inserted, repeated, cut, exchanged and late ones."""

import random
from collections.abc import Callable

from station.lab.wires import Address, MemoryDatagramEnd, MemoryInbox, SerialDeviceEnd

KINDS = ("flip", "drop", "insert", "repeat", "cut", "swap", "delay")


class Damage:
    """Damages the bytes of one direction."""

    def __init__(self, draw: random.Random) -> None:
        self.damaged = 0  #: bytes that were lost, changed, inserted, exchanged or delayed
        self._draw, self._interval, self._good, self._late = draw, 0.0, 0, b""
        self._passed = 1000  # bytes since the last start

    def start(self) -> None:
        """Damage the bytes from now on: of those that came since the last start, between a fifth and a single one."""
        self._interval = 5.0 * max(1.0, self._passed / 5.0) ** self._draw.random()
        self._good, self._passed = int(self._draw.expovariate(1.0 / self._interval)), 0

    def stop(self) -> None:
        """Damage no more bytes; late ones still arrive."""
        self._interval = 0.0

    def spoil(self, data: bytes) -> bytes:
        """Return what arrives of `data`, in the order of the line: after the late bytes of the last call."""
        out, self._late = bytearray(self._late), b""
        self._passed += len(data)
        while self._interval and len(data) > self._good:
            out += data[: self._good]
            arriving, data = self._fault(data[self._good :])
            out += arriving
            self._good = int(self._draw.expovariate(1.0 / self._interval))
        self._good -= len(data)
        return bytes(out + data)

    def _fault(self, data: bytes) -> tuple[bytes, bytes]:
        """Return what arrives of the first bytes of `data`, and the bytes behind them."""
        draw, kind = self._draw, self._draw.choice(KINDS)
        size = min(draw.choice((1, 1, 2, 3, 6, 20)), len(data))
        first, rest = data[:size], data[size:]
        match kind:
            case "flip":
                first = bytes(byte ^ 1 << draw.randrange(8) for byte in first)
            case "drop":
                first = b""
            case "insert":
                size = draw.randrange(1, 40)
                first, rest = draw.randbytes(size), data
            case "repeat":
                first += first
            case "cut":
                size, first, rest = len(data), b"", b""
            case "swap":
                first, rest, size = rest[:size] + first, rest[size:], size + len(rest[:size])
            case _:
                size, self._late, first, rest = len(data), data, b"", b""
        self.damaged += size
        return first, rest

    def datagrams(self, datagram: bytes, arrives: Callable[[bytes], bool] = lambda _: True) -> list[bytes]:
        """Return what arrives of a datagram: nothing, twice, with the next one, or other bytes if `arrives` permits."""
        draw, late = self._draw, [self._late] if self._late else []
        self._late = b""
        self._good, self._passed = self._good - len(datagram), self._passed + len(datagram)
        if not self._interval or self._good > 0:
            return [datagram, *late] if draw.random() < 0.5 else [*late, datagram]
        self._good = int(draw.expovariate(1.0 / self._interval))
        self.damaged += len(datagram)
        if (kind := draw.choice(KINDS)) in ("flip", "insert", "cut"):
            return [*late, changed] if arrives(changed := spoiled(datagram, draw)) else late
        match kind:
            case "repeat":
                return [*late, datagram, datagram]
            case "swap" | "delay":
                self._late = datagram
        return late


def spoiled(data: bytes, draw: random.Random) -> bytes:
    """Return `data` with about two faults."""
    damage = Damage(draw)
    damage._interval = 0.5 * len(data) + 0.5
    return damage.spoil(data)


class DamagedEnd(SerialDeviceEnd):
    """The device's end of a serial line that damages the bytes of both directions."""

    def __init__(self, name: str, draw: random.Random) -> None:
        super().__init__(name)
        self.directions = Damage(draw), Damage(draw)

    def read(self) -> bytes:
        return self.directions[0].spoil(super().read())

    def write(self, data: bytes) -> None:
        super().write(self.directions[1].spoil(data))


class DamagedNetwork(MemoryDatagramEnd):
    """A network that damages the datagrams to the hosts; one with other bytes arrives only if `arrives` permits it."""

    def __init__(self, draw: random.Random, arrives: Callable[[bytes, bytes], bool]) -> None:
        super().__init__()
        self.directions = (Damage(draw),)
        self._arrives = arrives

    def send(self, datagram: bytes, to: Address) -> None:
        for arriving in self.directions[0].datagrams(datagram, lambda changed: self._arrives(datagram, changed)):
            super().send(arriving, to)


class DamagedInbox(MemoryInbox):
    """A receiver of cameras' datagrams, of which some are damaged."""

    def __init__(self, draw: random.Random) -> None:
        super().__init__()
        self.directions = (Damage(draw),)

    def put(self, datagram: bytes) -> None:
        for arriving in self.directions[0].datagrams(datagram):
            super().put(arriving)
