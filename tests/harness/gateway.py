"""The gateway's process on a ring that is really written at 500 Hz, without a station around it.

`python -m tests.harness.gateway [SECONDS]` serves all of it on the usual ports; it says the process's number first, and
its share of a processor last.
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
from station.control.child import Child
from station.control.clock import REAL_TIME
from station.control.ring import HEARTBEAT
from station.control.states import State
from tests.harness.kill_recordings import Feed
from web.access.tokens import Tokens
from web.gateway.messages import Ready, Setup
from web.gateway.process import run_gateway
from web.gateway.seen import Told
from web.gateway.wanted import Address, Wanted

ANY = Address("127.0.0.1", 0)
#: What the rows say: tips [m], force [N] and moment [N m].
MEASURED, DESIRED, FORCE, MOMENT = (0.01, 0.02, 0.15), (0.011, 0.021, 0.149), (0.2, -0.1, 0.05), (0.001, 0.002, 0.003)
PAPER = load_robot("paper")


class Shown(Feed):
    """Rows in which everything is known and of now."""

    def pause(self) -> None:
        """Nothing comes any more."""
        self._stopping.set()

    def row(self, number: int) -> Array:
        row, of = super().row(number), self.channels.of
        of(row, "held")[:] = of(row, "trouble")[:] = 0.0
        of(row, "tip_measured")[:], of(row, "tip_desired")[:] = MEASURED, DESIRED
        of(row, "force")[:], of(row, "moment")[:] = FORCE, MOMENT
        self.ring.numbers[HEARTBEAT] = REAL_TIME.now()  # as the loop shows with every row that it lives
        return row


class Running:
    """A gateway, and the end of its pipe."""

    def __init__(self, child: Child, feed: Shown, lines: tuple[str, ...]) -> None:
        self.pipe: Connection = child.pipe
        self.feed, self.lines = feed, lines
        self.process = psutil.Process(child.pid)
        self._child = child

    @property
    def port(self) -> int:
        """Of its first line."""
        return int(self.lines[0].partition("?")[0].rstrip("/").rpartition(":")[2])

    def tell(self, told: Told) -> None:
        self._child.tell(told)


@contextmanager
def gateway(wanted: Wanted, tokens: Tokens | None = None) -> Iterator[Running]:
    """One that is ready."""
    with Shown(PAPER) as feed:
        child = Child(run_gateway, Setup(wanted, PAPER, REAL_TIME, None, tokens), feed.ring.name, name="gateway")
        try:
            assert child.pipe.poll(60.0)
            ready: Any = child.pipe.recv()
            assert isinstance(ready, Ready), ready
            running = Running(child, feed, ready.lines)
            running.tell(Told(State.RUNNING, "", (("controller.k1", 2.0), ("controller.strategy", "best"))))
            yield running
            assert child.alive
            child.end(20.0)
            assert child.ended(0.0) == "with status 0"
        finally:
            child.close(5.0)


def eventually(what: Callable[[], Any], patience: float = 30.0) -> Any:
    """The first true answer."""
    deadline = time.monotonic() + patience
    while not (answer := what()):
        assert time.monotonic() < deadline, f"not within {patience} s"
        time.sleep(0.01)
    return answer


if __name__ == "__main__":
    everything = Wanted(Address("127.0.0.1", 18944), Address("127.0.0.1", 8765), True, Address("127.0.0.1", 7447))
    with gateway(everything) as served:
        sys.stdout.write("\n".join((str(served.process.pid), *served.lines, "")))
        sys.stdout.flush()
        served.process.cpu_percent()
        time.sleep(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0)
        share, memory = served.process.cpu_percent(), served.process.memory_info().rss
        sys.stdout.write(f"{share:.1f} % of a processor, {memory / 1e6:.1f} MB\n")
