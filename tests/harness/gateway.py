"""A gateway process without a station, on a telemetry ring that a thread writes at 500 Hz.

`python -m tests.harness.gateway [SECONDS]` serves all protocols on their default ports. It prints the process ID first,
and the gateway's share of a processor at the end.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import psutil

from core.robot.robot import Array
from station.config.robots import load_robot
from station.control.child_process import ChildProcess
from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import HEARTBEAT
from station.control.states import State
from tests.tools.kill_recordings import Feed
from web.access.identity import Tokens
from web.gateway.options import GatewayOptions, ListenAddress
from web.gateway.process import GatewayReady, GatewaySetup, run_gateway
from web.gateway.snapshot import StationInfo

ANY = ListenAddress("127.0.0.1", 0)
#: Values in the telemetry rows: measured tip [m], desired tip [m], force [N] and moment [N m].
MEASURED, DESIRED, FORCE, MOMENT = (0.01, 0.02, 0.15), (0.011, 0.021, 0.149), (0.2, -0.1, 0.05), (0.001, 0.002, 0.003)
PAPER = load_robot("paper")


class Shown(Feed):
    """Writer of telemetry rows in which every value is known and current."""

    def pause(self) -> None:
        """Stop writing rows."""
        self._stopping.set()

    def row(self, number: int) -> Array:
        row, of = super().row(number), self.channels.of
        of(row, "estimates_frozen")[:] = of(row, "trouble")[:] = 0.0
        of(row, "tip_measured")[:], of(row, "tip_desired")[:] = MEASURED, DESIRED
        of(row, "force")[:], of(row, "moment")[:] = FORCE, MOMENT
        self.ring.numbers[HEARTBEAT] = REAL_TIME_CLOCK.now()  # as the control loop does with every row
        return row


class Running:
    """A running gateway process with the station's end of its pipe."""

    def __init__(self, child: ChildProcess, feed: Shown, lines: tuple[str, ...]) -> None:
        self.pipe: Connection = child.pipe
        self.feed, self.lines = feed, lines
        self.process = psutil.Process(child.pid)
        self._child = child

    @property
    def port(self) -> int:
        """Port in the first line that the gateway has reported."""
        return int(self.lines[0].partition("?")[0].rstrip("/").rpartition(":")[2])

    def tell(self, told: StationInfo) -> None:
        self._child.send(told)


@contextmanager
def gateway(wanted: GatewayOptions, tokens: Tokens | None = None) -> Iterator[Running]:
    """Yield a gateway process that is ready to serve."""
    with Shown(PAPER) as feed:
        child = ChildProcess(
            run_gateway, GatewaySetup(wanted, PAPER, REAL_TIME_CLOCK, None, tokens), feed.ring.name, name="gateway"
        )
        try:
            assert child.pipe.poll(60.0)
            ready: Any = child.pipe.recv()
            assert isinstance(ready, GatewayReady), ready
            running = Running(child, feed, ready.lines)
            running.tell(StationInfo(State.RUNNING, "", (("controller.k1", 2.0), ("controller.strategy", "best"))))
            yield running
            assert child.alive
            child.end(20.0)
            assert child.ended(0.0) == "with status 0"
        finally:
            child.close(5.0)


def eventually(what: Callable[[], Any], patience: float = 30.0) -> Any:
    """Call `what` until its result is true, and return this result; fail after `patience` [s]."""
    deadline = time.monotonic() + patience
    while not (answer := what()):
        assert time.monotonic() < deadline, f"not within {patience} s"
        time.sleep(0.01)
    return answer


if __name__ == "__main__":
    everything = GatewayOptions(
        ListenAddress("127.0.0.1", 18944), ListenAddress("127.0.0.1", 8765), True, ListenAddress("127.0.0.1", 7447)
    )
    with gateway(everything) as served:
        sys.stdout.write("\n".join((str(served.process.pid), *served.lines, "")))
        sys.stdout.flush()
        served.process.cpu_percent()
        time.sleep(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0)
        share, memory = served.process.cpu_percent(), served.process.memory_info().rss
        sys.stdout.write(f"{share:.1f} % of a processor, {memory / 1e6:.1f} MB\n")
