"""Fuzz test of the Aurora protocol on a disturbed serial line, for the driver's session and for the simulated unit.

    python -m tests.fuzz.aurora 1000000 1

Each case disturbs one exchange: bytes are lost, bits are flipped, or noise is inserted; replies are late, repeated,
cut short, of the wrong type, or absent. The fuzzer counts exceptions, ends of the line that do not recover, and false
accepts. A false accept is a value or a command that was never sent. The driver's session talks to a responder that was
written in this file from the protocol's description, not to the simulated unit.
"""

import json
import math
import random
import struct
import sys
from collections import Counter

import numpy as np

from station.devices.aurora.dialogue import AuroraSettings
from station.devices.aurora.protocol import binary, framed
from station.devices.aurora.session import AuroraSession
from station.devices.kernel.quality import Quality
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import SimulatedAurora
from tests.harness.damage import spoiled

#: Number of disturbed exchanges after which the session or the unit must prove that it still works.
ROUND = 25
#: Virtual time within which a session must recover [s]: the session searches at two baud rates, sends a break, sets up
#: the tools and starts tracking.
PATIENCE = 30.0
PERIOD = 1.0 / 40.0


def pieces(data: bytes, draw: random.Random) -> list[bytes]:
    """Return `data` cut into a few pieces."""
    cuts = sorted(draw.randrange(len(data) + 1) for _ in range(draw.randrange(4)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


class Responder:
    """Simple Aurora unit that answers every command as the protocol's description requires."""

    def __init__(self, draw: random.Random, old: bool) -> None:
        self.sent: dict[int, tuple[float, ...]] = {}  #: sent position of the coil by frame number [mm]
        self._draw = draw
        self._old = old
        self._tracking = self._prepared = 0

    def answer(self, command: str, now: float) -> bytes:
        name, _, rest = command.partition(":")
        if name in ("INIT", "TSTOP"):
            self._tracking = False
        elif name == "TSTART":
            self._tracking = True
        elif name == "PINIT":
            self._prepared = 1
        elif name == "PENA":
            self._prepared = 2
        elif name == "VER":
            return framed(f"Aurora\nFreeze Tag: AURORA Rev {'007' if self._old else '009'}\n")
        elif name == "PHSR":
            return framed({"02": "010A001", "03": "010A011", "00": "010A031"}.get(rest[:2], "00"))
        elif name == "PHINF":
            return framed("02000000NDI         0013A5C1D0031")
        elif name in ("BX", "TX"):
            return self._frame(name, now) if self._tracking else framed("ERROR0C")
        return framed("OKAY")

    def _frame(self, name: str, now: float) -> bytes:
        frame = int(now / PERIOD)
        wander = self._draw.uniform(-0.2, 0.2)
        hundredths = [
            round(100.0 * (value + wander)) for value in (20.0 * np.sin(0.2 * now), -10.0, -150.0 + now % 0.5)
        ]
        if frame not in self.sent:
            self.sent[frame] = tuple(h / 100.0 for h in hundredths)
            while len(self.sent) > 4000:
                del self.sent[next(iter(self.sent))]
        position = self.sent[frame]
        if name == "TX":
            text = "".join(f"{round(100.0 * value):+07d}" for value in position)
            return framed(f"010A+10000+00000+00000+00000{text}+0012000000031{frame:08X}\n0000")
        body = struct.pack("<BBB8fIIH", 1, 0x0A, 1, 1.0, 0.0, 0.0, 0.0, *position, 0.012, 0x31, frame, 0)
        return binary(body)


#: Function that returns a wrong reply with a correct CRC.
def wrong_kind(draw: random.Random) -> bytes:
    kind = draw.randrange(6)
    if kind == 0:
        return framed("OKAY")
    if kind == 1:
        return framed(f"ERROR{draw.randrange(256):02X}")
    if kind == 2:
        return framed("RESET")
    if kind == 3:
        return framed("".join(chr(draw.randrange(32, 127)) for _ in range(draw.randrange(70))))
    if kind == 4:
        return binary(draw.randbytes(draw.randrange(60)))
    return binary(struct.pack("<BBB", 1, 0x0A, draw.choice((1, 2, 4, 9))) + draw.randbytes(draw.randrange(48)))


class HostLine:
    """The driver's session and a responder on a line that can be disturbed."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        old = draw.random() < 0.25
        self.session = AuroraSession(AuroraSettings())
        self.responder = Responder(draw, old)
        self.now = 0.0
        self.good = self.false_accepts = 0
        self._late: list[bytes] = []

    def exchange(self, bad: bool) -> None:
        """Let the session send its next command, and answer it; `bad`: disturb the answer."""
        draw = self.draw
        for _ in range(60):  # until the session sends a command
            self.now += 0.002 if self.session.tracking else 0.02
            orders = self.session.due(self.now)
            if any(isinstance(order, bytes) for order in orders):
                break
        for order in orders:
            if not isinstance(order, bytes):
                continue
            answer = self.responder.answer(order[:-5].decode("ascii"), self.now)
            self.now += 0.005
            if bad:
                fate = draw.randrange(8)
                if fate == 0:
                    self._late.append(answer)
                    continue
                if fate == 1:
                    answer = wrong_kind(draw) + (answer if draw.random() < 0.5 else b"")
                elif fate == 2 and self._late:
                    answer = self._late.pop() + answer
                else:
                    answer = spoiled(answer, draw)
            for piece in pieces(answer, draw) if bad else [answer]:
                self._receive(piece)
            if bad and draw.random() < 0.1:
                self.now += draw.choice((0.05, 0.5, 3.0))

    def _receive(self, data: bytes) -> None:
        for seen in self.session.receive(data, self.now):
            if seen.quality is Quality.GOOD:
                self.good += 1
                true = self.responder.sent.get(seen.frame)
                # TX sends a frame in decimals and BX in single precision, so differences up to 1e-4 mm are rounding.
                if true is None or seen.position is None or math.dist(true, seen.position) > 1e-4:
                    self.false_accepts += 1

    def recovers(self) -> bool:
        """Return whether the session receives good frames again on an undisturbed line."""
        before, give_up = self.good, self.now + PATIENCE
        while self.good < before + 3 and self.now < give_up:
            self.exchange(bad=False)
        return self.good >= before + 3


COMMANDS = (
    *("INIT:", "VER:0", "COMM:00000", "PHSR:00", "PHSR:02", "PHSR:04", "PINIT:0a", "PENA:0AD"),
    *("PHINF:0A0001", "PHF:0A", "TSTART:", "TSTOP:", "TX:0801", "BX:0801", "TX:0001", "BX:0001"),
)


class DeviceLine:
    """A simulated Aurora unit and a host that sends disturbed commands."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        self.unit = SimulatedAurora(TrackerConfig(), np.random.default_rng(draw.randrange(2**32)))
        self.now = 0.0
        self.false_accepts = 0
        self._tip = np.zeros(3)
        self._said: set[str] = set()  # commands that were sent since the last CR

    def exchange(self, bad: bool) -> None:
        """Send one command; `bad`: disturb it."""
        command = self.draw.choice(COMMANDS)
        self.unit.executed.clear()
        data = spoiled(framed(command), self.draw) if bad else framed(command)
        self.say(data)
        # A command that has lost only its CR is executed with the next CR, even if that CR is noise.
        self._said.add(command)
        if bad and not self._said.issuperset(self.unit.executed):
            self.false_accepts += 1
        if b"\r" in data:
            self._said = set() if data.endswith(b"\r") else {command}

    def say(self, data: bytes) -> bytes:
        heard = b""
        for piece in pieces(data, self.draw):
            self.unit.receive(piece, self.now)
            heard += self._pass(0.02)
        return heard + self._pass(0.1)

    def _pass(self, time: float) -> bytes:
        self.unit.advance(self.now, self.now + time, self._tip, self._tip)
        self.now += time
        self.unit.receive(b"", self.now)
        return self.unit.transmit(self.now)

    def recovers(self) -> bool:
        """Return whether the unit answers a good command after CRs have ended the bytes that are left on the line."""
        for _ in range(10):
            self.say(b"\r")
        return framed("OKAY") in self.say(framed("INIT:"))


def fuzz(cases: int, seed: int) -> dict[str, int]:
    """Run `cases` disturbed exchanges, half with the session and half with the unit; return the counts."""
    draw = random.Random(seed)
    counts = Counter(cases=0, exceptions=0, hangs=0, false_accepts=0, good_frames=0)
    host, device = HostLine(draw), DeviceLine(draw)
    while counts["cases"] < cases:
        for line in (host, device):
            try:
                for _ in range(ROUND):
                    line.exchange(bad=True)
                    if draw.random() < 0.7:
                        line.exchange(bad=False)
                hung = not line.recovers()
            except Exception as error:  # any exception is a finding of the fuzzer
                counts["exceptions"] += 1
                sys.stderr.write(f"after {counts['cases']} cases: {error!r}\n")
                hung = True
            counts["cases"] += ROUND
            counts["hangs"] += hung
            counts["false_accepts"] += line.false_accepts
            line.false_accepts = 0
            if isinstance(line, HostLine):
                counts["good_frames"] += line.good
                line.good = 0
                if hung or draw.random() < 0.02:
                    host = HostLine(draw)
            elif hung or draw.random() < 0.02:
                device = DeviceLine(draw)
    return dict(counts)


if __name__ == "__main__":
    print(json.dumps(fuzz(int(sys.argv[1]), int(sys.argv[2]))))  # noqa: T201
