"""Fuzz test of the simulated Zaber units: `python -m tests.fuzz.zaber [CASES] [SEED]`.

The units receive noise and arbitrary commands. No code raises an exception, no stage leaves its hard stops, and the
good messages after a damaged one are understood. `tests.fuzz.devices` damages the line between a driver and the units.
"""

import random
import sys

from station.devices.zaber.protocol import BYTE_TIME_S, ZaberCommand, ZaberMessage, encode
from station.lab.simulated_zaber import Unit, UnitKind, simulated_chain
from tests.harness.damage import spoiled


class DeviceCase:
    """The device's side: a simulated chain that receives arbitrary bytes."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.now = 0.0
        rotary, linear = UnitKind(4421, None, 1_536_000), UnitKind(4332, 604_724, serial=1001)
        self.chain = simulated_chain([Unit(rotary, 1), Unit(rotary, 2), Unit(linear, 3)], processing=1e-4)
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
            self.chain.receive(spoiled(data, source) if kind == 1 else data, self.now)
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
    """Run `cases` cases, and return the counts."""
    source = random.Random(seed)
    result = {"cases": cases, "exceptions": 0, "hangs": 0, "false_accepts": 0}
    device = DeviceCase(source)
    for case in range(cases):
        try:
            device.torment()
            result["false_accepts"] += device.outside() or device.too_fast()
            if case % 4 == 0:
                result["hangs"] += not device.recovered()
                device = DeviceCase(source) if case % 200 == 0 else device
        except Exception as error:  # any exception is a finding of the fuzzer
            sys.stderr.write(f"case {case} of seed {seed}: {error!r}\n")
            result["exceptions"] += 1
            device = DeviceCase(source)
    return result


if __name__ == "__main__":
    cases, seed = [int(word) for word in sys.argv[1:3]] + [1_000_000, 1][len(sys.argv) - 1 :]
    sys.stdout.write(f"{fuzz(cases, seed)}\n")
