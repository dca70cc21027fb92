"""`ctr-station bench loop`: lateness of the control loop, which runs at 500 Hz in a separate process."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from core.errors import CtrError
from station.benchmarks.timer_probe import TimerProbe
from station.config.controllers import PERIOD_S
from station.config.loads import RaisedCosineLoad
from station.config.motions import CircleMotion
from station.control.realtime import last_core
from station.control.ring import Ring
from station.control.states import State
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor


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
            StationService(supervisor).start_motion(
                CircleMotion(radius=0.010, period=20.0),
                load=RaisedCosineLoad(peak=0.3, period=15.0),
                duration=seconds + 60.0,
            )
            start = time.monotonic()
            while (passed := time.monotonic() - start) < seconds:
                time.sleep(min(0.25, seconds - passed))
                progress(min(1.0, passed / seconds))
                status = supervisor.status()
                if status.state is not State.RUNNING:
                    raise CtrError(f"the loop changed to {status.state.name}: {status.cause}")
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
