"""Connect stages that start late, for many delays of their start: `python -m tests.tools.boots [NUMBER]`.

Prints a table: for each kind of stages and way to start, how many of the starts within 0.3 ... 9 s ended connected, how
many halted the stages until a person resets them, and the longest time from the end of the start until connected.
"""

import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from station.config.robots import RobotFile, load_robot
from station.devices.interfaces import Condition
from station.lab.config import StagesKind
from station.lab.simulated_gcode import SimulatedBoard
from station.lab.simulated_stages import STAGES
from tests.harness.stages_bench import StagesBench

#: Commands of the host that only a person can undo.
HALTS = (b"M112",)
KEPT_BYTES = 128  #: size of a serial port's buffer, whose content a device executes when it has started [bytes]
FIRST_S, LAST_S = 0.3, 9.0
#: Ways to start: the device or the adapter of its port loses or keeps the bytes; opening its port resets a board.
WAYS = ("loses bytes", "keeps bytes", "is reset")


class Boot(NamedTuple):
    """Result of a connection to stages that start late."""

    connected: bool
    halted: bool
    words: frozenset[str]  #: warnings while connecting
    took: float  #: time from the end of the start until connected [s]
    cause: str


def ways(kind: StagesKind) -> Sequence[str]:
    """Return the ways to start of a kind of stages: only boards are reset, and T-series units have no buffer."""
    return WAYS if kind in ("grbl", "marlin") else WAYS[:1] if kind == "zaber" else WAYS[:2]


def boot(robot: RobotFile, kind: StagesKind, way: str, seconds: float) -> Boot:
    """Connect stages that start for `seconds` after their port was opened."""
    bench, sent, words = StagesBench(robot, kind), bytearray(), set[str]()
    if way == "is reset":
        assert isinstance(bench.simulated, SimulatedBoard)
        bench.simulated.start_for(seconds)
    receive, kept = bench.simulated.receive, bytearray()

    def received(data: bytes, now: float) -> None:
        sent.extend(data)
        if way != "is reset" and now < seconds:
            kept.extend(data[: KEPT_BYTES - len(kept)] if way == "keeps bytes" else b"")
            return
        receive(bytes(kept) + data, now)
        kept.clear()

    def ended() -> bool:
        words.add(bench.cause)
        return bench.stages.condition is not Condition.CONNECTING

    bench.simulated.receive = received
    bench.stages.connect(bench.now)
    bench.run(30.0, until=ended)
    connected, took, cause = bench.stages.condition is Condition.CONNECTED, bench.now - seconds, bench.cause
    bench.run(1.0)
    connected &= bench.stages.condition is Condition.CONNECTED and bench.stages.ready == (way != "is reset")
    return Boot(connected, any(halt in sent for halt in HALTS), frozenset(words - {""}), took, cause or bench.cause)


def main(number: int) -> None:
    """Print the table of `number` starts for each kind and way."""
    robot = load_robot("paper")
    print(f"{'stages':12} {'the device':12} connected  halted  longest time after the start [s]")  # noqa: T201
    for kind in STAGES:
        for way in ways(kind):
            found = [boot(robot, kind, way, seconds) for seconds in np.linspace(FIRST_S, LAST_S, number).tolist()]
            good, halted = sum(each.connected for each in found), sum(each.halted for each in found)
            took = max(each.took for each in found)
            print(f"{kind:12} {way:12} {good:2} of {number:2}   {halted:2}      {took:.2f}", flush=True)  # noqa: T201
            for cause in {each.cause for each in found if not each.connected}:
                print(f"    {cause}")  # noqa: T201


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
