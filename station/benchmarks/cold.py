"""Time of a new installation to its first result, before anything is compiled.

    ctr-station bench cold

Runs the experiment `fig7` with `ctr-station run`, first with an empty folder of compiled code, then again. Then
counts in one process what this run compiles.
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
    """Return seconds of the first and second run, the number of compiled signatures, and the compile time."""
    with tempfile.TemporaryDirectory() as folder:
        shared, alone = Path(folder, "shared"), Path(folder, "alone")
        run = ["-m", "station", "run", EXPERIMENT, "--json", "--out", folder]
        first, _ = _timed(run, shared)
        second, _ = _timed(run, shared)
        _, counted = _timed(["-m", __name__], alone)
    return {"first_run_s": round(first, 1), "second_run_s": round(second, 1), **json.loads(counted)}


def _timed(arguments: list[str], cache: Path) -> tuple[float, str]:
    """Run Python with compiled code in `cache`; return the seconds and its last line."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    start = time.perf_counter()
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE)  # noqa: S603 - ourselves
    return time.perf_counter() - start, done.stdout.decode().splitlines()[-1]


def _count() -> dict[str, Any]:
    """Run the experiment for one second in this process and count compilations."""
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
