"""Fuzz test of both directions of the Zaber serial line: `python tests/fuzz/zaber.py [cases] [seed]`.

The Zaber protocol has no checksum, so a corrupted byte alone cannot be detected. The fuzzer checks that no code raises
an exception, and that the good messages after a corrupted one are understood. It also checks that the host accepts no
position whose error exceeds `READING_TOLERANCE`.
"""

import random
import sys

from station.devices.zaber.chain import Axis, ZaberChain
from station.devices.zaber.estimate import READING_TOLERANCE
from station.devices.zaber.protocol import BYTE_TIME_S, MESSAGE_TIME_S, ZaberCommand, ZaberMessage, encode
from station.lab.simulated_zaber import SimulatedChain
from station.lab.zaber_unit import Unit, UnitKind

AXES = (Axis(1, 9102, 38, 3_072_000), Axis(2, 9102, 38, 3_072_000), Axis(3, 4300, 18, 251_968))
ANSWERS = {ZaberCommand.POSITION, ZaberCommand.STATUS}


def damage(data: bytes, source: random.Random) -> bytes:
    """Return `data` with one or two bits flipped, or with bytes lost, inserted or doubled."""
    out = bytearray(data)
    for _ in range(source.choice((1, 1, 2))):
        at = source.randrange(len(out)) if out else 0
        match source.randrange(6):
            case 0 | 1 if out:
                out[at] ^= 1 << source.randrange(8)
            case 2 if out:
                del out[at : at + source.randrange(1, 6)]
            case 3:
                out[at:at] = source.randbytes(source.randrange(1, 20))
            case 4:
                out[at:at] = out[: source.randrange(1, 7)]
            case _:
                # A forged reply that reports a wrong position of the axis.
                fake = ZaberMessage(
                    source.randrange(0, 5), source.choice((60, 54, 9, 255, 22)), source.randrange(-9, 3_100_000)
                )
                out[at:at] = encode(fake)[source.randrange(2) :]
    return bytes(out)


class HostCase:
    """The host's side: it polls three axes at rest, whose replies are sometimes corrupted."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.now = 0.0
        self.truth = [source.randrange(axis.maximum) for axis in AXES]
        self.chain = ZaberChain(AXES)
        self.chain.polling = True
        self.exchange(12, harm=False)

    def exchange(self, messages: int, harm: bool) -> None:
        """Advance the line by `messages` requests with their replies; `harm`: corrupt one of the replies."""
        harmed = self.source.randrange(messages) if harm else -1
        for slot in range(messages):
            reply = b""
            sent = self.chain.due(self.now)
            if sent and sent[1] in ANSWERS:
                position = self.truth[sent[0] - 1] if sent[1] == ZaberCommand.POSITION else 0
                reply = encode(ZaberMessage(sent[0], sent[1], position))
            self.now += 2.0 * MESSAGE_TIME_S
            if slot == harmed:
                if not reply:
                    harmed += 1  # the corruption applies to the next request that has a reply
                else:
                    reply = damage(reply, self.source)
            cut = self.source.randrange(len(reply) + 1) if harm else len(reply)
            self.chain.feed(reply[:cut], self.now)
            self.chain.feed(reply[cut:], self.now + BYTE_TIME_S)
            self.now += BYTE_TIME_S

    def wrong(self) -> bool:
        """Return whether the host has accepted a wrong position."""
        return any(
            estimate.known and abs(estimate.position - truth) > READING_TOLERANCE
            for estimate, truth in zip(self.chain.estimates, self.truth, strict=True)
        )

    def recovered(self) -> bool:
        """Return whether the host's positions are exact again after half a second of good replies."""
        for _ in range(4):
            self.exchange(9, harm=False)
            if not self.chain.lost and all(
                estimate.known and abs(estimate.position - truth) < 0.5
                for estimate, truth in zip(self.chain.estimates, self.truth, strict=True)
            ):
                return True
        return False


class DeviceCase:
    """The device's side: a simulated chain that receives arbitrary bytes."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.now = 0.0
        rotary, linear = UnitKind(4421, None, 1_536_000), UnitKind(4332, 604_724, serial=1001)
        self.chain = SimulatedChain([Unit(rotary, 1), Unit(rotary, 2), Unit(linear, 3)], processing=1e-4)
        self.answered = 0

    def torment(self) -> None:
        """Send noise, commands with arbitrary data, and corrupted commands."""
        source = self.source
        for _ in range(source.randrange(1, 4)):
            kind = source.randrange(3)
            command = source.choice(
                (1, 2, 16, 17, 18, 20, 21, 22, 23, 37, 40, 43, 44, 45, 47, 53, 54, 60, source.randrange(256))
            )
            magnitude = 1 << source.randrange(32)
            order = ZaberMessage(source.randrange(5), command, source.randrange(-magnitude, magnitude))
            data = source.randbytes(source.randrange(1, 30)) if kind == 0 else encode(order)
            self.chain.receive(damage(data, source) if kind == 1 else data, self.now)
            self.now += source.choice((0.002, 0.01, 0.3))
            self.answered += len(self.chain.advance(self.now))

    def too_fast(self) -> bool:
        """Return whether the chain has sent more bytes than the line can carry."""
        return self.answered > self.now / BYTE_TIME_S + 1.0

    def outside(self) -> bool:
        """Return whether a stage is beyond its hard stops."""
        return not -2001.0 <= self.chain.units[2].true_position <= 604_724 + 2001.0

    def recovered(self) -> bool:
        """Return whether, after a silence, every unit that still has its device number answers an echo request."""
        self.now += 1.2  # longer than a renumbering or a restart of the units takes
        self.chain.advance(self.now)
        self.now += 0.5
        self.chain.advance(self.now)
        number = self.chain.units[0].number
        alone = [unit.number for unit in self.chain.units].count(number) == 1
        self.chain.receive(encode(ZaberMessage(number, ZaberCommand.ECHO, 1234)), self.now)
        self.now += 0.5
        # Only five bytes are compared, as the sixth may be a message ID. Bytes of another message may precede them.
        echo = encode(ZaberMessage(number, ZaberCommand.ECHO, 1234))[:5]
        return not alone or echo in self.chain.advance(self.now)


def fuzz(cases: int, seed: int) -> dict[str, int]:
    """Run half of the cases with the host's side, half with the simulated units; return the counts."""
    source = random.Random(seed)
    result = {"cases": 0, "exceptions": 0, "hangs": 0, "false_accepts": 0}
    host, device = HostCase(source), DeviceCase(source)
    for case in range(cases):
        result["cases"] += 1
        try:
            if case % 2 == 0:
                host.exchange(4, harm=True)
                result["false_accepts"] += host.wrong()
                if not host.recovered():
                    result["hangs"] += 1
                    host = HostCase(source)
            else:
                device.torment()
                result["false_accepts"] += device.outside() or device.too_fast()
                if case % 8 == 1:
                    result["hangs"] += not device.recovered()
                    device = DeviceCase(source) if case % 400 == 1 else device
        except Exception as error:  # any exception is a finding of the fuzzer
            if not result["exceptions"]:
                sys.stderr.write(f"case {case} of seed {seed}: {error!r}\n")
            result["exceptions"] += 1
            host, device = HostCase(source), DeviceCase(source)
    return result


if __name__ == "__main__":
    cases, seed = [int(word) for word in sys.argv[1:3]] + [1_000_000, 1][len(sys.argv) - 1 :]
    sys.stdout.write(f"{fuzz(cases, seed)}\n")
