"""Damages the bytes of every protocol: `python -m tests.fuzz.devices PROTOCOL [DAMAGED BYTES] [SEED]`.

Each driver runs on its simulated device, whose line is damaged for a while and then clean. Meanwhile the driver must
raise nothing and must give no wrong position, pose, wrench or target as a good one. On the clean line it must give good
ones again.
"""

import asyncio
import itertools
import math
import random
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Protocol

import numpy as np
from pyigtl.messages import TransformMessage

from core.robot.robot import Array
from station.config.robots import load_robot
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.interfaces import Condition
from tests.harness.aurora_bench import REST
from tests.harness.damage import Damage, DamagedEnd, DamagedInbox, DamagedNetwork
from tests.harness.gateway import ANY, PAPER
from tests.harness.sensor_benches import WRENCHES, NetftBench
from tests.harness.stages_bench import KINDS, StagesBench, swing
from tests.harness.tracker_benches import AuroraTrackerBench, StereoBench, TrackerBench
from web.gateway.igtl import TARGET_NAME, IgtlServer

DAMAGE_S = 0.5  #: duration of each damage [s]
LEAST_ROUNDS = 10  #: smallest number of damages, each with its recovery


@dataclass
class Found:
    """Counts of a run."""

    damaged: int = 0  #: bytes that were lost, changed, inserted, exchanged or delayed
    good: int = 0  #: values that the driver gave as good ones
    wrong: int = 0  #: those that were not true
    worst: float = 0.0  #: largest error of a position, as a share of its tolerance

    def compare(self, error: float) -> None:
        """Count a position with this error, as a share of its tolerance."""
        self.good, self.wrong, self.worst = self.good + 1, self.wrong + (error > 1.0), max(self.worst, error)

    exceptions: int = 0
    hangs: int = 0  #: damages after which the driver gave no good values on the clean line


class Case(Protocol):
    """A driver and its simulated device on a line that can be damaged."""

    directions: Sequence[Damage]

    def run(self, seconds: float, found: Found) -> None:
        """Let the driver run for `seconds`, and count its good and wrong values."""
        ...

    def recovers(self, found: Found) -> bool:
        """Return whether the driver gives good values again on the clean line."""
        ...


class StagesCase:
    """A driver of stages. While no reading is valid, an axis that executes a damaged velocity has another position."""

    TOLERANCE = np.array([0.06, 0.06, 0.004])  #: [rad, rad, m]

    def __init__(self, kind: str, draw: random.Random) -> None:
        self._bench = StagesBench(load_robot("paper"), kind, seed=draw.randrange(1000))
        self._bench.host.device = end = DamagedEnd(kind, draw)
        self.directions = end.directions
        self._bench.connect()
        self._numbers = [getattr(unit, "number", None) for unit in self._bench.simulated.units]

    def run(self, seconds: float, found: Found) -> None:
        bench = self._bench

        def compared(now: float) -> Sequence[float]:
            if bench.stages.ready:
                found.compare(float((np.abs(bench.reading.positions - bench.truth) / self.TOLERANCE).max()))
            return swing(now)

        bench.run(seconds, compared)

    def recovers(self, found: Found) -> bool:
        bench = self._bench.run(0.3).connect()
        if bench.stages.condition is not Condition.CONNECTED:
            bench.run(1.0).connect()  # damaged bytes can restart a device, which is then silent for a while
        numbers = [getattr(unit, "number", None) for unit in bench.simulated.units]
        if not bench.stages.ready:  # a stage that was lost is connected, and must be homed
            if numbers != self._numbers and "numbered" in bench.cause:
                raise Renewed  # bytes without a checksum can give a device another number
            raise Renewed if bench.stages.condition is Condition.CONNECTED else Broken(bench.cause)
        self.run(0.1, found)
        return True


class Renewed(Exception):
    """The device needs a person, as it states, so another one takes its place."""


class Broken(Exception):
    """The driver does not recover."""


def circle(time: float) -> Array:
    """Return a position on a circle of 5 mm with a period of 2 s."""
    return REST + 0.005 * np.array([math.cos(math.pi * time) - 1.0, math.sin(math.pi * time), 0.0])


class TrackerCase:
    """A driver of a tracker, whose tip moves on a circle."""

    TOLERANCE = 2.5e-4  #: while frames of a camera are lost, its pixels are extrapolated [m]
    LATE_S = 0.15  #: largest error of the time of a measurement, while messages are late [s]
    RECOVERY_S = 15.0  #: time to search the unit and set it up at most two times [s]

    def __init__(self, bench: TrackerBench, directions: Sequence[Damage]) -> None:
        self._bench, self.directions = bench, directions
        bench.tracker.connect(0.0)
        bench.run(1.0, circle)

    def run(self, seconds: float, found: Found) -> None:
        for _, reading in self._bench.run(seconds, circle):
            times = reading.time + np.linspace(-self.LATE_S, self.LATE_S, 61)
            error = min(float(np.linalg.norm(reading.position - circle(time))) for time in times)
            found.compare(error / self.TOLERANCE)

    def recovers(self, found: Found) -> bool:
        start = self._bench.now
        while self._bench.now - start < self.RECOVERY_S:
            before = found.good
            self.run(0.5, found)
            if found.good - before > 10:
                return True
        return False


class SensorsCase:
    """The driver of two Net F/T boxes. UDP's checksum drops the records whose wrench was damaged."""

    def __init__(self, draw: random.Random) -> None:
        def arrives(sent: bytes, changed: bytes) -> bool:
            return len(changed) % len(sent) != 0 or changed[12:] == sent[12:]

        ends = [DamagedNetwork(draw, arrives) for _ in WRENCHES]
        self._bench = NetftBench(ends)
        self.directions = [one for end in ends for one in end.directions]
        self._bench.sensors.connect(0.0)
        self._bench.run(0.5)
        self._load = itertools.cycle((1.0, 1.2, 1.4, 1.6))

    def run(self, seconds: float, found: Found) -> None:
        before = self._bench.sensors.poll(self._bench.now).wrenches
        load = next(self._load) * WRENCHES
        for _, reading in self._bench.run(seconds, load):
            found.good += reading.usable
            # Between two samples the wrench is interpolated, so it is between the last load and this one.
            low, high = np.minimum(before, load) - 1e-5, np.maximum(before, load) + 1e-5
            found.wrong += not ((low <= reading.wrenches) & (reading.wrenches <= high)).all()

    def recovers(self, found: Found) -> bool:
        self.run(1.0, found)
        (_, reading), *_ = self._bench.run(0.002, load := next(self._load) * WRENCHES)
        (*_, (_, reading)) = self._bench.run(0.05, load)
        return reading.usable and np.allclose(reading.wrenches, load, atol=1e-5)


class TargetsCase:
    """The OpenIGTLink server with a client that sends targets; bytes that are no message end the connection."""

    MESSAGES = 200  #: messages in 1 s

    def __init__(self, draw: random.Random) -> None:
        self.directions = (Damage(draw),)
        self._number = 0

    def run(self, seconds: float, found: Found) -> None:
        self.directions[0].spoil(b"")  # late bytes of the last connection never arrive
        sent = {self._number + k: self._message(self._number + k) for k in range(round(seconds * self.MESSAGES))}
        self._number += len(sent)
        received = asyncio.run(self._exchange([self.directions[0].spoil(message) for message in sent.values()]))
        found.good += len(received)
        found.wrong += sum(each not in sent for each in received)

    def recovers(self, found: Found) -> bool:
        before = found.good
        self.run(0.1, found)
        return found.good == before + 0.1 * self.MESSAGES

    def _message(self, number: int) -> bytes:
        matrix = np.eye(4)
        matrix[:3, 3] = number, -number, 3.0
        return TransformMessage(matrix, device_name=TARGET_NAME, timestamp=1.0 + number).pack()

    async def _exchange(self, messages: Sequence[bytes]) -> list[float]:
        received: list[float] = []
        server = IgtlServer(PAPER.robot(), lambda position, _: received.append(self._read(position)), lambda _: None)
        address = await server.open(ANY)
        reader, writer = await asyncio.open_connection(address.host, address.port)
        try:
            writer.write(b"".join(messages))
            writer.write_eof()
            await asyncio.wait_for(reader.read(), 30.0)
        except ConnectionError:
            pass  # the server has refused the bytes
        finally:
            writer.close()
            await server.close()
        return received

    def _read(self, position: Array) -> float:
        x, y, z = (1e3 * position).tolist()
        return round(x, 3) if abs(x + y) + abs(z - 3.0) < 1e-3 else math.nan


def _stages(kind: str) -> Callable[[random.Random], Case]:
    return lambda draw: StagesCase(kind, draw)


def _aurora(draw: random.Random, *, text: bool) -> Case:
    end = DamagedEnd("aurora", draw)
    return TrackerCase(AuroraTrackerBench(AuroraSettings(always_tx=text), end), end.directions)


def _stereo(draw: random.Random) -> Case:
    inbox = DamagedInbox(draw)
    return TrackerCase(StereoBench(inbox), inbox.directions)


#: Every protocol by which bytes come in.
PROTOCOLS: dict[str, Callable[[random.Random], Case]] = {
    **{kind: _stages(kind) for kind in KINDS},
    "aurora binary": partial(_aurora, text=False),
    "aurora text": partial(_aurora, text=True),
    "stereo": _stereo,
    "netft": SensorsCase,
    "openigtlink": TargetsCase,
}


def fuzz(protocol: str, damaged: int, seed: int) -> Found:
    """Damage at least so many bytes of a protocol, and return the counts."""
    draw, found, rounds = random.Random(seed), Found(), 0
    case = PROTOCOLS[protocol](draw)
    while found.damaged < damaged or rounds < LEAST_ROUNDS:
        rounds += 1
        try:
            for direction in case.directions:
                direction.start()
            case.run(DAMAGE_S, found)
            for direction in case.directions:
                direction.stop()
                found.damaged, direction.damaged = found.damaged + direction.damaged, 0
            if not case.recovers(found):
                raise Broken
        except Renewed:
            case = PROTOCOLS[protocol](draw)
        except Exception as error:  # any exception is a finding
            found.hangs += isinstance(error, Broken)
            found.exceptions += not isinstance(error, Broken)
            sys.stderr.write(f"{protocol}, seed {seed}, {found.damaged} bytes: {traceback.format_exc()}\n")
            case = PROTOCOLS[protocol](draw)
    return found


if __name__ == "__main__":
    name, *numbers = sys.argv[1:]
    count, start = [int(number) for number in numbers] + [1_000_000, 1][len(numbers) :]
    sys.stdout.write(f"{asdict(fuzz(name, count, start))}\n")
