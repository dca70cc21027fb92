"""Carry out a sweep that is killed and continued: `python -m tests.tools.killed_sweep 60`.

The sweep is carried out three times: on two local processes without interruption, on two local processes, and on a Dask
cluster of a scheduler and two workers. In the last two, a worker is killed after a third of the runs, and the command
after half of them, each with kill -9; the same command continues. The three tables are compared.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tests.harness.cases import SHORT
from tests.harness.children import children
from tests.harness.root import ROOT
from tests.harness.waiting import until

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "100"}
#: Option for the simulated times of the runs of the first and the second half [s]: a client that is killed after half
#: of the runs has not finished the others.
DURATIONS = "duration=0.2,10.0"

Client = subprocess.Popen[Any]


class Cluster(NamedTuple):
    """A Dask scheduler, to which workers can be added."""

    address: str
    scheduler: Client
    start: Callable[..., Client]

    def worker(self, first: str = "") -> Client:
        """Add a worker process that is not restarted; it executes the code `first` before anything else."""
        options = ("--host=127.0.0.1", "--no-nanny", "--nthreads=1", "--no-dashboard")
        return self.start("dask_worker", first, self.address, *options)


@contextmanager
def cluster(folder: Path, workers: int, environment: Mapping[str, str] = ENVIRONMENT) -> Iterator[Cluster]:
    """Yield a cluster of separate processes that have not imported the sweep; their logs are in the folder."""
    with ExitStack() as ends:

        def start(module: str, first: str, *arguments: str) -> Client:
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
    swept = ("--seeds", str(runs // 2), "--set", DURATIONS, "--folder", str(folder))
    return [sys.executable, "-m", "station", "sweep", str(experiment), *swept, *options]


def rows(manifest: Path) -> list[Mapping[str, Any]]:
    """Return the rows of a manifest; an incomplete last line is omitted."""
    if not manifest.is_file():
        return []
    lines = manifest.read_text(encoding="utf-8").split("\n")[1:-1]
    return [json.loads(line) for line in lines]


def wait_for_rows(folder: Path, count: int, client: Client) -> int:
    """Wait until a sweep has `count` rows, however long it takes; fail if its client ends before."""
    while len(found := rows(folder / "manifest.jsonl")) < count:
        assert client.poll() is None, "the sweep has ended"
        time.sleep(0.02)
    return len(found)


class Sweep(NamedTuple):
    """A completed sweep."""

    killed_at: Sequence[int]  #: numbers of finished runs when the worker and the client were killed
    printed: str  #: what the last command has printed on stderr
    table: Mapping[str, Any]  #: `table` of the sweep


def table(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of a sweep without what depends on the computer's clock and on the folder."""
    runs = [{key: value for key, value in row.items() if key != "wall_s"} for row in summary["runs"]]
    return {**summary, "runs": runs, "wall_s": 0.0, "recording": ""}


def swept(
    command: Sequence[str], runs: int, *, kill_worker: Callable[[Client], None] | None = None, kill_client: bool = False
) -> Sweep:
    """Carry out a sweep, kill a worker after a third of the runs and the command after half of them, and repeat it."""
    folder, killed_at = Path(command[command.index("--folder") + 1]), list[int]()

    def start() -> Client:
        pipe = subprocess.PIPE
        return subprocess.Popen([*command, "--json"], env=ENVIRONMENT, stdout=pipe, stderr=pipe, text=True)

    client = start()
    try:
        if kill_worker is not None:
            killed_at.append(wait_for_rows(folder, runs // 3, client))
            kill_worker(client)
        if kill_client:
            wait_for_rows(folder, runs // 2, client)
            client.kill()
            client.communicate()
            killed_at.append(len(rows(folder / "manifest.jsonl")))
            client = start()
        out, errors = client.communicate()
    finally:
        client.kill()
        client.wait()
    assert client.returncode == 0, errors
    return Sweep(killed_at, errors, table(json.loads(out)))


def kill_process(client: Client) -> None:
    """Kill a worker process that a sweep has started, locally or with Dask."""
    children(client.pid, word="spawn_main")[0].kill()


def experiment_in(folder: Path) -> Path:
    """Write the experiment of the sweeps and return its file."""
    path = folder / "own.toml"
    path.write_text(SHORT, encoding="utf-8")
    return path


def killed_sweeps(folder: Path, runs: int) -> tuple[Sweep, Sweep, Sweep]:
    """Return the sweep on processes, the same sweep killed and continued, and both again on a cluster."""
    experiment, local = experiment_in(folder), ("--jobs", "2")
    whole = swept(sweep_command(experiment, runs, folder / "whole", *local), runs)
    command = sweep_command(experiment, runs, folder / "killed", *local)
    killed = swept(command, runs, kill_worker=kill_process, kill_client=True)
    with cluster(folder, 1) as there:
        victim = there.worker()
        command = sweep_command(experiment, runs, folder / "dask", "--scheduler", there.address)
        return whole, killed, swept(command, runs, kill_worker=lambda _: victim.kill(), kill_client=True)


def main() -> None:
    """Carry out the sweeps and print their results."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    with tempfile.TemporaryDirectory(prefix="ctr-sweep-") as folder:
        whole, killed, dask = killed_sweeps(Path(folder), runs)
    print(f"{len(whole.table['runs'])} runs; worker and client killed after:")  # noqa: T201
    for name, sweep in (("processes", killed), ("Dask", dask)):
        print(f"{name}: {sweep.killed_at} runs; same table: {sweep.table == whole.table}")  # noqa: T201
    sys.exit(0 if whole.table == killed.table == dask.table else 1)


if __name__ == "__main__":
    main()
