"""Fuzzes both directions of the Zaber line: `python tests/fuzz/zaber.py [cases] [seed]`.

The protocol has no checksum, so that a damaged byte alone can not be told from a good one. What must hold:
nothing raises, nothing hangs (after a damage the next good messages are understood), and the host believes
no position that is farther from the truth than its own slack.
"""

import random
import sys

from station.devices.zaber.chain import Axis, Chain
from station.devices.zaber.estimate import SLACK
from station.devices.zaber.protocol import BYTE_TIME, MESSAGE_TIME, Command, Message, encode
from station.lab.zaber.simulated import SimulatedChain
from station.lab.zaber.unit import Unit, UnitKind

AXES = (Axis(1, 9102, 38, 3_072_000), Axis(2, 9102, 38, 3_072_000), Axis(3, 4300, 18, 251_968))
ANSWERS = {Command.POSITION, Command.STATUS}


def damage(data: bytes, source: random.Random) -> bytes:
    """One or two bits turned, bytes lost, put in or doubled."""
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
                # What would move the axis if it were believed.
                fake = Message(
                    source.randrange(0, 5), source.choice((60, 54, 9, 255, 22)), source.randrange(-9, 3_100_000)
                )
                out[at:at] = encode(fake)[source.randrange(2) :]
    return bytes(out)


class HostCase:
    """A chain that polls three axes at rest; their answers get damaged now and then."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.now = 0.0
        self.truth = [source.randrange(axis.maximum) for axis in AXES]
        self.chain = Chain(AXES)
        self.chain.polling = True
        self.exchange(12, harm=False)

    def exchange(self, messages: int, harm: bool) -> None:
        """So many slots of the line, each with its answer."""
        harmed = self.source.randrange(messages) if harm else -1
        for slot in range(messages):
            reply = b""
            sent = self.chain.due(self.now)
            if sent and sent[1] in ANSWERS:
                position = self.truth[sent[0] - 1] if sent[1] == Command.POSITION else 0
                reply = encode(Message(sent[0], sent[1], position))
            self.now += 2.0 * MESSAGE_TIME
            if slot == harmed:
                if not reply:
                    harmed += 1  # the next one that has an answer
                else:
                    reply = damage(reply, self.source)
            cut = self.source.randrange(len(reply) + 1) if harm else len(reply)
            self.chain.feed(reply[:cut], self.now)
            self.chain.feed(reply[cut:], self.now + BYTE_TIME)
            self.now += BYTE_TIME

    def wrong(self) -> bool:
        """The host believes in a position that is not so."""
        return any(
            estimate.known and abs(estimate.position - truth) > SLACK
            for estimate, truth in zip(self.chain.estimates, self.truth, strict=True)
        )

    def recovered(self) -> bool:
        """Exact again within half a second of good answers."""
        for _ in range(4):
            self.exchange(9, harm=False)
            if not self.chain.lost and all(
                estimate.known and abs(estimate.position - truth) < 0.5
                for estimate, truth in zip(self.chain.estimates, self.truth, strict=True)
            ):
                return True
        return False


class DeviceCase:
    """A simulated chain that is told anything at all."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.now = 0.0
        rotary, linear = UnitKind(4421, None, 1_536_000), UnitKind(4332, 604_724, serial=1001)
        self.chain = SimulatedChain([Unit(rotary, 1), Unit(rotary, 2), Unit(linear, 3)], processing=1e-4)
        self.answered = 0

    def torment(self) -> None:
        """Noise, real commands with any data, damaged ones."""
        source = self.source
        for _ in range(source.randrange(1, 4)):
            kind = source.randrange(3)
            command = source.choice(
                (1, 2, 16, 17, 18, 20, 21, 22, 23, 37, 40, 43, 44, 45, 47, 53, 54, 60, source.randrange(256))
            )
            magnitude = 1 << source.randrange(32)
            order = Message(source.randrange(5), command, source.randrange(-magnitude, magnitude))
            data = source.randbytes(source.randrange(1, 30)) if kind == 0 else encode(order)
            self.chain.receive(damage(data, source) if kind == 1 else data, self.now)
            self.now += source.choice((0.002, 0.01, 0.3))
            self.answered += len(self.chain.advance(self.now))

    def too_fast(self) -> bool:
        """More bytes came than the line can have carried."""
        return self.answered > self.now / BYTE_TIME + 1.0

    def outside(self) -> bool:
        """A stage is beyond its hard stops."""
        return not -2001.0 <= self.chain.units[2].place <= 604_724 + 2001.0

    def recovered(self) -> bool:
        """After a silence an echo comes back from every unit that has kept its number."""
        self.now += 1.2  # longer than a renumbering or a restart
        self.chain.advance(self.now)
        self.now += 0.5
        self.chain.advance(self.now)
        number = self.chain.units[0].number
        alone = [unit.number for unit in self.chain.units].count(number) == 1
        self.chain.receive(encode(Message(number, Command.ECHO, 1234)), self.now)
        self.now += 0.5
        # The sixth byte may be a message ID; what comes before may be the rest of another message.
        echo = encode(Message(number, Command.ECHO, 1234))[:5]
        return not alone or echo in self.chain.advance(self.now)


def fuzz(cases: int, seed: int) -> dict[str, int]:
    """Half of the cases go to the host's side, half to the simulated units'."""
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
        except Exception as error:  # what it looks for
            if not result["exceptions"]:
                sys.stderr.write(f"case {case} of seed {seed}: {error!r}\n")
            result["exceptions"] += 1
            host, device = HostCase(source), DeviceCase(source)
    return result


if __name__ == "__main__":
    cases, seed = [int(word) for word in sys.argv[1:3]] + [1_000_000, 1][len(sys.argv) - 1 :]
    sys.stdout.write(f"{fuzz(cases, seed)}\n")
