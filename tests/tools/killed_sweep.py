"""Run a sweep on a Dask cluster that loses a worker and its client: `python -m tests.tools.killed_sweep 200`.

The cluster is a scheduler and two workers, real processes on this computer. After a third of the runs one worker is
killed for good. After two thirds the client is killed, and the same command is started again. The result is compared
row by row with the same sweep on local processes.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tests.harness.cases import SHORT
from tests.harness.root import ROOT
from tests.harness.waiting import until

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "100"}


class Figures(NamedTuple):
    """Result of a sweep whose worker and client were killed."""

    worker_killed_at: int  #: number of finished runs when the worker was killed
    client_killed_at: int
    rows: list[Mapping[str, Any]]  #: rows of the sweep's manifest
    local: list[Mapping[str, Any]]
    status: int  #: exit status of the client that was started again
    said: str  #: output of the client that was started again
    before_s: float  #: time until the client was killed [s]
    after_s: float  #: run time of the client that was started again [s]
    local_s: float


class Cluster(NamedTuple):
    """A Dask scheduler, to which workers can be added."""

    address: str
    scheduler: subprocess.Popen[bytes]
    start: Callable[..., subprocess.Popen[bytes]]

    def worker(self, first: str = "") -> subprocess.Popen[bytes]:
        """Add a worker process that is not restarted; it executes the code `first` before anything else."""
        options = ("--host=127.0.0.1", "--no-nanny", "--nthreads=1", "--no-dashboard")
        return self.start("dask_worker", first, self.address, *options)


@contextmanager
def cluster(folder: Path, workers: int, environment: Mapping[str, str] = ENVIRONMENT) -> Iterator[Cluster]:
    """Yield a cluster of separate processes that have not imported the sweep; their logs are in the folder."""
    with ExitStack() as ends:

        def start(module: str, first: str, *arguments: str) -> subprocess.Popen[bytes]:
            log = ends.enter_context((folder / f"{module}.log").open("ab"))
            code = f"{first}\nfrom distributed.cli.{module} import main\nmain()"
            command = [sys.executable, "-c", code, *arguments]
            process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
            ends.callback(process.wait)
            ends.callback(process.kill)
            return process

        file = folder / "scheduler.json"
        scheduler = start(
            "dask_scheduler", "", "--host=127.0.0.1", "--port=0", "--no-dashboard", f"--scheduler-file={file}"
        )
        until(lambda: file.is_file() and file.read_text(encoding="utf-8").rstrip().endswith("}"))
        there = Cluster(json.loads(file.read_text(encoding="utf-8"))["address"], scheduler, start)
        for _ in range(workers):
            there.worker()
        yield there


def sweep_command(experiment: Path, runs: int, folder: Path, *options: str) -> list[str]:
    """Return the command of a sweep with `runs` runs, which must be an even number."""
    swept = ("--seeds", str(runs // 2), "--set", "controller.k1=1,2.5")
    return [sys.executable, "-m", "station", "sweep", str(experiment), *swept, "--folder", str(folder), *options]


def rows(manifest: Path) -> list[Mapping[str, Any]]:
    """Return the rows of a manifest; an incomplete last line is omitted."""
    if not manifest.is_file():
        return []
    lines = manifest.read_text(encoding="utf-8").split("\n")[1:-1]
    return [json.loads(line) for line in lines]


def wait_for_rows(folder: Path, count: int, client: subprocess.Popen[Any]) -> int:
    """Wait until a sweep has `count` rows, however long it takes; fail if its client ends before."""
    while len(found := rows(folder / "manifest.jsonl")) < count:
        assert client.poll() is None, "the sweep has ended"
        time.sleep(0.02)
    return len(found)


def without_clock(found: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rows in the order of the runs, without the columns that depend on the computer's clock."""
    kept = [{key: value for key, value in row.items() if key != "wall_s"} for row in found]
    return sorted(kept, key=lambda row: row["run"])


def killed_sweep(folder: Path, runs: int) -> Figures:
    """Run the whole scenario in a folder and return its result."""
    experiment, dask, local = folder / "own.toml", folder / "dask", folder / "local"
    experiment.write_text(SHORT.replace("duration = 1.0", "duration = 0.2"), encoding="utf-8")
    with cluster(folder, 1) as there:
        victim = there.worker()
        command = sweep_command(experiment, runs, dask, "--scheduler", there.address)
        begin = time.perf_counter()
        client = subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
        try:
            first = wait_for_rows(dask, runs // 3, client)
            victim.kill()
            wait_for_rows(dask, 2 * runs // 3, client)
        finally:
            client.kill()
            client.wait()
        before = time.perf_counter() - begin
        second = len(rows(dask / "manifest.jsonl"))
        begin = time.perf_counter()
        again = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
        after = time.perf_counter() - begin
    begin = time.perf_counter()
    command = sweep_command(experiment, runs, local, "--jobs", "2")
    subprocess.run(command, cwd=folder, env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)
    wall = time.perf_counter() - begin
    found, alone = (rows(place / "manifest.jsonl") for place in (dask, local))
    said = again.stdout + again.stderr
    return Figures(first, second, found, alone, again.returncode, said, before, after, wall)


def main() -> None:
    """Run the scenario and print its result."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    with tempfile.TemporaryDirectory(prefix="ctr-sweep-") as folder:
        found = killed_sweep(Path(folder), runs)
    once = len({row["run"] for row in found.rows})
    equal = without_clock(found.rows) == without_clock(found.local)
    print(f"{found.said.strip()}\n")  # noqa: T201
    print(f"{runs} runs; a worker was killed after {found.worker_killed_at}, the client after {found.client_killed_at}")  # noqa: T201
    print(f"rows {len(found.rows)}, of different runs {once}, all equal to those of processes: {equal}")  # noqa: T201
    print(f"{found.before_s:.0f} s, then {found.after_s:.0f} s; on two processes {found.local_s:.0f} s")  # noqa: T201
    sys.exit(0 if found.status == 0 and len(found.rows) == once == runs and equal else 1)


if __name__ == "__main__":
    main()
