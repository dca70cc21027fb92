"""How punctual the loop is while a page is open: `python -m tests.harness.loop_with_panel [SECONDS] [--config FILE]`.

`ctr-station bench loop` has the control process, the lab and the recorder; here the server, the scene and a Chromium
that draws the page are on the same processors. One recorded motion under load; the loop's own counts, with the time
that the machine was stolen meanwhile. With `fifo = false` in the file: without real-time scheduling.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import sync_playwright

from station.bench.loop import figures, stolen
from station.bench.timer_probe import TimerProbe
from station.config.robots import load_robot
from station.control.process import ring_width
from station.control.ring import Ring
from tests.harness.chromium import CHROMIUM, FLAGS, SIZE
from tests.harness.serving import Served, serving, shared_memory

MOTION = {
    "trajectory": {"kind": "circle", "radius": 0.010, "period": 20.0},
    "load": {"kind": "raised_cosine", "peak": 0.3, "period": 15.0},
}
#: Chromium has started and drawn its first pictures by then, and the robot is at rest no more [s].
DRAWN, MOVING = 10.0, 5.0


@contextmanager
def _served(settings: str) -> Iterator[tuple[Served, str]]:
    """A station and the name of its shared memory."""
    with serving(settings=settings, rate=None) as station:
        yield station, shared_memory(station.process.pid).pop().name


def main() -> None:
    """Print the loop's timing as JSON."""
    parser = argparse.ArgumentParser(prog="python -m tests.harness.loop_with_panel")
    parser.add_argument("seconds", type=float, nargs="?", default=60.0)
    parser.add_argument("--config", help="station file of the paper's robot")
    parsed = parser.parse_args()
    core = max(os.sched_getaffinity(0))
    settings = Path(parsed.config).read_text(encoding="utf-8") if parsed.config else ""
    with TimerProbe(core) as probe, sync_playwright() as playwright, _served(settings) as (station, ring_name):
        station.ready()
        ring = Ring(ring_width(load_robot("paper")), ring_name)
        page = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS).new_page(viewport=SIZE)
        page.goto(station.url)
        time.sleep(DRAWN)
        started = station.post("/api/start", {**MOTION, "duration": parsed.seconds + 60.0})
        assert started.status_code == 202, started.text
        time.sleep(MOVING)
        ring.clear_timing()
        probe.clear()
        before = stolen()
        time.sleep(parsed.seconds)
        status = station.status()
        result = {
            **figures(ring, parsed.seconds, stolen() - before),
            "computer": probe.figures(),
            "state": f"{status['state']} {status['cause']}".strip(),  # a run that had to be held says why
        }
        station.post("/api/stop")
        page.close()
        ring.close(remove=False)
    sys.stdout.write(f"{json.dumps(result)}\n")


if __name__ == "__main__":
    main()
