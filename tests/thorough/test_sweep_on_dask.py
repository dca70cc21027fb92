"""Sweeps on Dask: real schedulers and workers, some of them killed."""

import importlib.util
import os
import signal
import subprocess
import sys

import psutil
import pytest

from tests.harness.root import ROOT
from tests.harness.serving import free_port
from tests.harness.waiting import NET, until
from tests.tools.killed_sweep import cluster, killed_sweeps, rows, sweep_command, wait_for_rows

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="the extra dask is not installed"
)


#: Number of runs in a sweep that loses a worker and its client.
RUNS = 60
#: Program with three clients: one with the cluster's certificate, one without encryption, one without a certificate.
STRANGERS = """
from distributed import Client
from station.jobs.dask_cluster import LOCAL, dask_workers
from tests.virtual.station.jobs.test_run_jobs import square

if __name__ == "__main__":
    reports = []
    with dask_workers(LOCAL, 1, reports.append) as own:
        address = reports[0].split(": ")[0].removeprefix("Dask at ")
        assert address.startswith("tls://127.0.0.1:"), address
        print(own.submit(square, 3).result())
        for stranger in (address.replace("tls://", "tcp://"), address):
            try:
                Client(stranger, timeout="10s").close()
            except (OSError, ValueError, TypeError):
                print("refused")
"""


@pytest.fixture
def own(write, short):
    """Return an experiment of a fifth of a second at rest."""
    return write(short.replace("duration = 1.0", "duration = 0.2"))


def busy(pid: int) -> bool:
    """Return whether a worker has started to compute; killing an idle worker would only make the test longer."""
    return psutil.Process(pid).cpu_times().user > 4.0


def carry_out(command, folder, environment):
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_sweeps_that_lose_a_worker_and_their_client_have_the_table_of_the_whole_sweep(tmp_path):
    whole, killed, dask = killed_sweeps(tmp_path, RUNS)
    assert [row["completed"] for row in whole.table["runs"]] == [True] * RUNS
    for again in (killed, dask):
        assert RUNS // 3 <= again.killed_at[0] <= again.killed_at[1] < RUNS
        assert again.table == whole.table
    assert "1 workers; dashboard: " in dask.printed


def test_ctrl_c_keeps_the_finished_runs_and_leaves_no_dask_worker(own, environment, tmp_path):
    folder = tmp_path / "dask"
    command = sweep_command(own, 2000, folder, "--scheduler", "local", "--jobs", "1")
    client = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        wait_for_rows(folder, 2, client)
        workers = psutil.Process(client.pid).children(recursive=True)
        os.killpg(client.pid, signal.SIGINT)  # a terminal also sends SIGINT to every process of the group
        out, errors = client.communicate()
    finally:
        client.kill()
        client.wait()

    kept = rows(folder / "manifest.jsonl")
    assert client.returncode == 1, errors
    assert f"{len(kept)} of 2000 runs in" in out
    assert all(row["completed"] for row in kept)
    _, left = psutil.wait_procs(workers, timeout=NET)
    assert left == []


def test_a_run_that_repeatedly_ends_its_dask_worker_gets_a_row_with_the_reason(write, short, environment, tmp_path):
    endless = write(short.replace("duration = 1.0", "duration = 3600.0"))
    folder, impatient = tmp_path / "dask", {**environment, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with cluster(tmp_path, 0, impatient) as there:
        command = [sys.executable, "-m", "station", "sweep", str(endless), "--seeds", "1", "--folder", str(folder)]
        command += ["--scheduler", there.address]
        client = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
        try:
            while client.poll() is None:
                worker = there.worker()
                until(lambda worker=worker: client.poll() is not None or busy(worker.pid))
                worker.kill()
                worker.wait()
            out, _ = client.communicate()
        finally:
            client.kill()
            client.wait()

    assert client.returncode == 1
    assert [row["completed"] for row in rows(folder / "manifest.jsonl")] == [False]
    assert "own, seed 0: its worker process ended before it was done" in " ".join(out.split())
    assert "0 of 1" in out


def test_a_lost_dask_scheduler_ends_the_sweep_and_keeps_the_finished_runs(own, environment, tmp_path):
    folder, hasty = tmp_path / "dask", {**environment, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}
    with cluster(tmp_path, 1) as there:
        command = sweep_command(own, 2000, folder, "--scheduler", there.address)
        client = subprocess.Popen(command, cwd=tmp_path, env=hasty, stderr=subprocess.PIPE, text=True)
        try:
            wait_for_rows(folder, 2, client)
            there.scheduler.kill()
            _, errors = client.communicate()
        finally:
            client.kill()
            client.wait()

    assert client.returncode == 2
    assert "the scheduler is gone; the results are stored; repeat the command to continue" in errors
    assert 2 <= len(rows(folder / "manifest.jsonl")) < 2000


def test_a_missing_dask_scheduler_is_reported_in_one_line(own, environment, tmp_path):
    address = f"tcp://127.0.0.1:{free_port()}"
    done = carry_out(sweep_command(own, 2, tmp_path / "dask", "--scheduler", address), tmp_path, environment)

    assert done.returncode == 2
    assert f"--scheduler {address}: no Dask scheduler answers at this address" in done.stderr.splitlines()[-1]


def test_dask_workers_without_ctr_station_end_the_sweep_with_a_reason_and_no_row(own, environment, tmp_path):
    folder = tmp_path / "dask"
    with cluster(tmp_path, 0) as there:
        there.worker("import sys; sys.modules['station'] = None")
        done = carry_out(sweep_command(own, 2, folder, "--scheduler", there.address), tmp_path, environment)

    assert done.returncode == 2
    assert "a worker cannot carry out jobs: ModuleNotFoundError" in done.stderr.splitlines()[-1]
    assert rows(folder / "manifest.jsonl") == []


def test_the_local_dask_scheduler_refuses_clients_without_its_certificate() -> None:
    """Every user of the computer can connect to the scheduler's port, and a scheduler executes what a client sends.

    The check runs in a separate process, because Dask's threads for certificates outlive its cluster.
    """
    done = subprocess.run([sys.executable, "-c", STRANGERS], capture_output=True, text=True, timeout=NET, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["9", "refused", "refused"]
