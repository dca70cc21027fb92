"""Send start, goto, STOP and reset in random order to a live station, and disconnect clients at random.

`python -m tests.tools.random_orders 200 [SEED]` counts the motions that no valid command requested. Counters of the
control process in shared memory show which run it has started last. The control process writes them before it
acknowledges a STOP, so the check does not depend on answers or clocks.
"""

import itertools
import random
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from station.control.ring import COUNTERS, RUN, STATE
from station.control.states import State
from tests.harness.serving import Served, serving, shared_memory
from tests.harness.slow_client import Answer, SlowClient

#: Waypoints [s, m], so many that their check on the model takes a large part of a second.
POINTS = [[0.5 * (k + 1), 0.0, 0.003 * (k % 2), 0.0] for k in range(300)]
STARTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("/api/start", {"trajectory": {"kind": "waypoints", "points": POINTS}, "duration": 150.0}),
    ("/api/start", {"trajectory": {"kind": "circle", "radius": 0.005, "period": 8.0}, "duration": 60.0}),
    ("/api/start", {"experiment": "demo"}),
    ("/api/goto", {"joints": {"outer_rotation": 1.5}}),
    ("/api/goto", {"joints": {"outer_rotation": 0.0, "inner_rotation": 1.5}}),
)


@dataclass
class Sent:
    """A motion command that was sent and is not answered yet."""

    client: SlowClient
    path: str
    lost: bool = False


class RandomOrders:
    """One station and the clients that command it in random order."""

    def __init__(self, station: Served, seed: int) -> None:
        self._station, self._chance = station, random.Random(seed)
        (segment,) = shared_memory(station.process.pid)
        self._counters = np.memmap(segment, np.int64, "r", shape=(COUNTERS,))
        self.counts: Counter[str] = Counter()
        self._marker, self._sent = "", 0  # first line of this sequence in the log, and number of its commands so far
        self.unrequested: list[str] = []

    def one(self) -> None:
        """Send a few commands, STOPs and resets, disconnect clients, and check that no old command causes motion."""
        chance, sent = self._chance, list[Sent]()
        self._station.ready()
        self._marker, self._sent = f"order {self.counts['orders']}", 0
        self._station.post("/api/operator", {"take_over": True, "name": self._marker})
        for _ in range(chance.randint(3, 8)):
            act = chance.choice(("start", "start", "start", "lose", "lose", "stop", "stop and reset", "pause"))
            self.counts[act] += 1
            if act == "start" and len(sent) < 4:
                sent.append(self._send())
            elif act == "lose" and sent:
                lost = chance.choice(sent)
                lost.client.hang_up()
                lost.lost = True
            elif act.startswith("stop"):
                self._stop(sent, reset=act == "stop and reset")
            else:
                time.sleep(chance.uniform(0.0, 0.3))
        self._stop(sent, reset=True)
        self.counts["orders"] += 1

    def _send(self) -> Sent:
        path, body = self._chance.choice(STARTS)
        sent = Sent(SlowClient(self._station.port), path)
        sent.client.send("POST", path, body)
        self._sent += 1
        self.counts["commands"] += 1
        return sent

    def _stop(self, sent: list[Sent], *, reset: bool) -> None:
        """Send STOP and optionally a reset; check that no command sent before causes a motion afterwards."""
        assert self._station.post("/api/stop").status_code == 200
        carried_out = int(self._counters[RUN])
        if reset:
            assert self._station.post("/api/reset").status_code in (200, 409)
        for one in sent:
            answer = None if one.lost else one.client.answer()
            one.client.hang_up()
            self._judge(one, answer, carried_out)
        # The end of a lost command is recognised by its line in the log.
        while sent and any(one.lost for one in sent) and self._busy():
            time.sleep(0.05)
        if int(self._counters[RUN]) != carried_out or int(self._counters[STATE]) == State.RUNNING:
            self.unrequested.append(f"run {int(self._counters[RUN])} after STOP of {carried_out}: {sent}")
        sent.clear()
        if not reset and self._station.status()["state"] == "STOPPED":
            self._station.post("/api/reset")

    def _judge(self, one: Sent, answer: Answer | None, carried_out: int) -> None:
        what = "lost" if answer is None else "carried out" if answer.status == 202 else f"refused {answer.status}"
        if answer is not None and answer.status == 409 and "is void" in answer.body["error"]:
            what = "void"
        self.counts[what] += 1

    def _busy(self) -> bool:
        """Return whether the station still executes a request; each request has a line in the log at its end."""
        whats = [entry["what"] for entry in self._station.rest.get("/api/log?count=200").json()]
        newer = itertools.takewhile(lambda what: self._marker not in what, whats)
        return sum(path in what for what in newer for path in ("POST /api/start", "POST /api/goto")) < self._sent


def main() -> None:
    times, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    begin = time.monotonic()
    with serving() as station:
        orders = RandomOrders(station, seed)
        for number in range(times):
            orders.one()
            sys.stdout.write(f"{number + 1} {time.monotonic() - begin:.0f} s {dict(orders.counts)}\n")
            sys.stdout.flush()
    sys.stdout.write(f"motions that no valid command requested: {len(orders.unrequested)}\n")
    for each in orders.unrequested:
        sys.stdout.write(f"  {each}\n")


if __name__ == "__main__":
    main()
