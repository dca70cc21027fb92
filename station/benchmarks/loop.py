"""`ctr-station bench loop`: lateness of the control loop, which runs at 500 Hz in a separate process."""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Self

from core.errors import CtrError
from station.config.controllers import PERIOD_S
from station.config.loads import RaisedCosineLoad
from station.config.motions import CircleMotion
from station.control.child_process import ChildProcess
from station.control.realtime import last_core, request_fifo, request_realtime, set_process_name
from station.control.ring import SCHEDULER, Ring
from station.control.states import State
from station.service.commands import Start
from station.service.station_file import load_station
from station.service.supervisor import Supervisor

#: Real-time priority of the timer, above that of the control loop and of its other threads.
PRIORITY = 90
#: Interval at which the timer checks whether its parent process is alive [periods of 2 ms].
PARENT_CHECK_PERIODS = 500


class TimerProbe:
    """Process that wakes every 2 ms on one processor and records its lateness; used in a `with` block.

    The kernel or the host of a virtual machine delays this timer, and no program on the computer can prevent such a
    delay. The lateness of the timer is the lower bound of the loop's lateness.
    """

    def __init__(self, core: int | None) -> None:
        """Start the process on `core`, the processor of the control loop; None: on any processor."""
        self._ring = Ring(1)
        self._child = ChildProcess(_watch, self._ring.name, core, name="timer probe")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.terminate()
        self._child.ended()
        self._child.pipe.close()
        self._ring.close(remove=True)

    def clear(self) -> None:
        """Clear the recorded lateness."""
        self._ring.clear_timing()

    def figures(self) -> dict[str, Any]:
        """Return the lateness of the timer, and the number of its ticks that were a period late or more."""
        timing = self._ring.timing()
        return {
            "ticks": timing.ticks,
            "late_us": timing.late_us,
            "a_period_late": self._ring.later_than(PERIOD_S),
            "scheduler": timing.scheduler,
        }


def _watch(ring_name: str, core: int | None, _pipe: Connection, parent: int) -> None:
    """Main function of the timer's process."""
    set_process_name("ctr-probe")
    ring = Ring(1, ring_name)
    request_realtime(fifo=False, core=core)
    ring.counters[SCHEDULER] = request_fifo(PRIORITY)
    start, tick = time.monotonic(), 0
    while tick % PARENT_CHECK_PERIODS or os.getppid() == parent:  # a late timer skips ticks, which may delay this check
        due = start + tick * PERIOD_S
        left = due - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        late = time.monotonic() - due
        skipped = int(late / PERIOD_S)
        ring.time_late(late, skipped)
        tick += 1 + skipped


def loop(seconds: float, progress: Callable[[float], None], *, fifo: bool = True) -> dict[str, Any]:
    """Run a recorded circle under load in the virtual lab for `seconds`, and measure the lateness of the control loop.

    `computer` has the same numbers for a timer without work on the processor of the control loop. They are the lower
    bound of the loop's lateness.

    Raises:
        CtrError: the control process failed during the measurement.
    """
    core = last_core()
    bench = replace(load_station(None).bench(), fifo=fifo, core=core)
    with tempfile.TemporaryDirectory(prefix="ctr-bench-") as folder, TimerProbe(core) as probe:
        supervisor = Supervisor(bench, Path(folder))
        try:
            supervisor.open()
            supervisor.wait_ready(120.0)
            steal = stolen_seconds()
            supervisor.ring.clear_timing()
            probe.clear()
            motion, load = CircleMotion(radius=0.010, period=20.0), RaisedCosineLoad(peak=0.3, period=15.0)
            supervisor.send(Start(trajectory=motion, load=load, duration=seconds + 60.0))
            start = time.monotonic()
            while (passed := time.monotonic() - start) < seconds:
                time.sleep(min(0.25, seconds - passed))
                progress(min(1.0, passed / seconds))
                status = supervisor.status()
                if status.state is not State.RUNNING:
                    raise CtrError(f"the loop left RUNNING and is in {status.state.name}: {status.cause}")
            result = {**figures(supervisor.ring, seconds, stolen_seconds() - steal), "computer": probe.figures()}
        finally:
            supervisor.close()
    return result


def figures(ring: Ring, seconds: float, stolen_s: float) -> dict[str, Any]:
    """Return the timing of the control loop over `seconds` [s]; `stolen_s` is time taken by the hypervisor [s]."""
    late = ring.later_than(PERIOD_S)
    return {**ring.timing()._asdict(), "a_period_late": late, "seconds": seconds, "stolen_s": round(stolen_s, 3)}


def stolen_seconds() -> float:
    """Return the time that the hypervisor took from all processors of this computer [s]; 0 if it is not reported."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    except OSError:
        return 0.0
    return int(fields[8]) / 100.0 if len(fields) > 8 else 0.0
