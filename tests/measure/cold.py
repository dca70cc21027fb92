"""Time that a new installation needs for its first run, while no compiled code exists.

    python -m tests.measure cold

The benchmark runs the experiment `fig7` with `ctr-station run` twice. The folder of compiled code is empty before the
first run. Then a process runs one second of the experiment and counts the functions that numba compiles.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

EXPERIMENT = "fig7"


def cold() -> dict[str, Any]:
    """Return the times of the first and second run [s], the number of compilations, and their time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        shared, alone = Path(folder, "shared"), Path(folder, "alone")
        run = ["-m", "station", "run", EXPERIMENT, "--json", "--out", folder]
        first, _ = _timed(run, shared)
        second, _ = _timed(run, shared)
        _, counted = _timed(["-m", __name__], alone)
    return {"first_run_s": round(first, 1), "second_run_s": round(second, 1), **json.loads(counted)}


def _timed(arguments: list[str], cache: Path) -> tuple[float, str]:
    """Run Python with the folder `cache` for compiled code; return the time [s] and the last line of the output."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    start = time.perf_counter()
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE)
    return time.perf_counter() - start, done.stdout.decode().splitlines()[-1]


def _count() -> dict[str, Any]:
    """Run one second of the experiment in this process; return the number and the time [s] of compilations."""
    from numba.core import event  # pyright: ignore

    from station.control.clock import VirtualClock
    from station.experiments.experiment import load_experiment
    from station.experiments.runner import run_case

    with event.install_recorder("numba:compile") as recorded:  # pyright: ignore
        (case,) = load_experiment(EXPERIMENT).cases
        short = case.file.model_copy(update={"duration": 1.0})
        run_case(case._replace(file=short), 0, VirtualClock(), lambda _: None)
    compiled, depth, seconds, started = 0, 0, 0.0, 0.0
    for moment, what in recorded.buffer:  # pyright: ignore
        depth += 1 if what.is_start else -1  # pyright: ignore
        if what.is_start and depth == 1:  # pyright: ignore
            started = moment
        elif depth == 0:
            seconds += moment - started
        compiled += what.is_end  # pyright: ignore
    return {"compiled": compiled, "compile_s": round(seconds, 1)}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_count()) + "\n")
