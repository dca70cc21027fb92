"""Start of a station with simulated devices, then its processor time and memory at rest, without and with a page."""

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import httpx

from core.errors import CtrError
from station.benchmarks.served import START_TIMEOUT_S, ServedStation, browser, open_page, serve_station

#: Number of measured starts. An unmeasured start precedes them, because it compiles on a new installation.
STARTS = 3


class Use(NamedTuple):
    """Processor time and memory of a process."""

    processor: float  #: processor time since its start [s]
    memory: float  #: memory, with the process's share of shared memory [MB]


def rest(seconds: float, progress: Callable[[float], None]) -> dict[str, Any]:
    """Measure starts of a station, and for `seconds` [s] its processes while the robot is at rest.

    Raises:
        CtrError: the operating system does not list processes in /proc, or the station does not start.
    """
    if not Path("/proc/self/smaps_rollup").exists():
        raise CtrError("processes are not listed in /proc: this needs Linux")
    starts: list[ServedStation] = []
    used: list[float] = []
    result: dict[str, Any] = {}
    for number in range(STARTS + 1):
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            station = stack.enter_context(serve_station(folder, {}))
            if number:
                starts.append(station)
                used.append(sum(use.processor for use in processes(station.pid).values()))
            if number == STARTS:
                result["no page"] = _at_rest(station, seconds)
                progress(0.7)
                if (chromium := browser()) is not None:
                    stack.enter_context(open_page(station, chromium, folder / "browser"))
                    # When a page opens first, the station checks all experiments with the model; this request waits.
                    httpx.get(f"{station.url}api/experiments", timeout=START_TIMEOUT_S).raise_for_status()
                    result["page open"] = _at_rest(station, seconds)
        progress(0.1 * (number + 1) if number < STARTS else 1.0)
    return {
        "start": {
            "address_s": round(statistics.median(start.address_s for start in starts), 2),
            "ready_s": round(statistics.median(start.ready_s for start in starts), 2),
            "processor_s": round(statistics.median(used), 2),
        },
        **result,
    }


def _at_rest(station: ServedStation, seconds: float) -> dict[str, Any]:
    """Return processor use [% of one processor] and memory [MB] of each process of a station during `seconds` [s]."""
    before, started = processes(station.pid), time.monotonic()
    time.sleep(seconds)
    after, passed = processes(station.pid), time.monotonic() - started
    percent = {name: 100.0 * (after[name].processor - use.processor) / passed for name, use in before.items()}
    return {
        "processor_percent": {name: round(value, 1) for name, value in percent.items()},
        "processor_percent_sum": round(sum(percent.values()), 1),
        "memory_MB": {name: round(after[name].memory) for name in before},
        "memory_MB_sum": round(sum(after[name].memory for name in before)),
    }


def processes(pid: int) -> dict[str, Use]:
    """Return processor time and memory of the process `pid`, named `station`, and of its children by name.

    The values of children with the same name, such as several cameras, are added.
    """
    found = {"station": _use(pid)}
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            name, use = Path(f"/proc/{child}/comm").read_text().strip(), _use(int(child))
            known = found.get(name, Use(0.0, 0.0))
            found[name] = Use(known.processor + use.processor, known.memory + use.memory)
    return found


def _use(pid: int) -> Use:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
    shared_fairly = next(line for line in rollup.splitlines() if line.startswith("Pss:"))
    return Use((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), int(shared_fairly.split()[1]) / 1024)
