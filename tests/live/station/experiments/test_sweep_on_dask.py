"""Sweeps on Dask: real schedulers and workers, some of them killed."""

import importlib.util
import os
import signal
import subprocess
import sys

import psutil
import pytest

from tests.harness.killed_sweep import Figures, cluster, killed_sweep, rows, sweep_command, wait_for_rows, without_clock
from tests.harness.waiting import NET, until

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="the extra dask is not installed"
)


#: Of the sweeps that lose somebody.
RUNS = 12


@pytest.fixture
def own(write, short):
    """A fifth of a second at rest."""
    return write(short.replace("duration = 1.0", "duration = 0.2"))


def busy(pid: int) -> bool:
    """Whether a worker has begun to compute; one that is killed before makes the test longer, nothing else."""
    return psutil.Process(pid).cpu_times().user > 4.0


def carry_out(command, folder, environment):
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Figures:
    """A sweep that loses a worker and its client, and the same one on processes."""
    return killed_sweep(tmp_path_factory.mktemp("killed"), RUNS)


def test_a_worker_and_then_the_client_are_killed_and_every_run_is_there_once_as_from_processes(killed):
    assert killed.status == 0, killed.said
    assert RUNS // 3 <= killed.worker_killed_at < killed.client_killed_at < RUNS
    assert "1 workers; dashboard: " in killed.said
    assert f"{RUNS} of {RUNS} runs, {RUNS - killed.client_killed_at} of them now" in killed.said
    assert sorted(row["run"] for row in killed.rows) == list(range(RUNS))
    assert without_clock(killed.rows) == without_clock(killed.local)


def test_a_cluster_of_ones_own_gives_the_rows_of_processes_although_a_worker_is_killed(
    killed, own, environment, tmp_path
):
    dask = tmp_path / "dask"
    command = sweep_command(own, RUNS, dask, "--scheduler", "local", "--jobs", "2")
    client = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        wait_for_rows(dask, 3, client)
        workers = [one for one in psutil.Process(client.pid).children() if "spawn_main" in " ".join(one.cmdline())]
        workers[0].kill()
        _, said = client.communicate()
    finally:
        client.kill()
        client.wait()

    assert (len(workers), client.returncode) == (2, 0), said
    assert "2 workers; dashboard: http://127.0.0.1:" in said
    found = rows(dask / "manifest.jsonl")
    assert len(found) == RUNS
    assert without_clock(found) == without_clock(killed.local)


def test_ctrl_c_keeps_what_is_done_and_leaves_no_worker(own, environment, tmp_path):
    folder = tmp_path / "dask"
    command = sweep_command(own, 2000, folder, "--scheduler", "local", "--jobs", "1")
    client = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        wait_for_rows(folder, 2, client)
        workers = psutil.Process(client.pid).children(recursive=True)
        os.killpg(client.pid, signal.SIGINT)  # as a terminal does: everybody hears it
        out, said = client.communicate()
    finally:
        client.kill()
        client.wait()

    kept = rows(folder / "manifest.jsonl")
    assert client.returncode == 1, said
    assert f"{len(kept)} of 2000 runs in" in out
    assert all(row["completed"] for row in kept)
    _, left = psutil.wait_procs(workers, timeout=NET)
    assert left == []


def test_a_run_that_loses_its_workers_time_after_time_is_a_row_with_that_reason(write, short, environment, tmp_path):
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
    assert "own, seed 0: its worker was lost in the middle of it" in out
    assert "0 of 1" in out


def test_a_scheduler_that_goes_ends_the_sweep_with_what_is_done_kept(own, environment, tmp_path):
    folder, hasty = tmp_path / "dask", {**environment, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}
    with cluster(tmp_path, 1) as there:
        command = sweep_command(own, 2000, folder, "--scheduler", there.address)
        client = subprocess.Popen(command, cwd=tmp_path, env=hasty, stderr=subprocess.PIPE, text=True)
        try:
            wait_for_rows(folder, 2, client)
            there.scheduler.kill()
            _, said = client.communicate()
        finally:
            client.kill()
            client.wait()

    assert client.returncode == 2
    assert "the scheduler has gone; what is done is kept, and the same command goes on" in said
    assert 2 <= len(rows(folder / "manifest.jsonl")) < 2000


def test_no_scheduler_there_is_said_in_a_line(own, environment, tmp_path):
    with cluster(tmp_path, 0) as gone:
        pass
    done = carry_out(sweep_command(own, 2, tmp_path / "dask", "--scheduler", gone.address), tmp_path, environment)

    assert done.returncode == 2
    assert f"--scheduler {gone.address}: no Dask scheduler answers there" in done.stderr.splitlines()[-1]


def test_workers_without_the_station_end_the_sweep_with_the_reason_and_without_a_row(own, environment, tmp_path):
    folder = tmp_path / "dask"
    with cluster(tmp_path, 0) as there:
        there.worker("import sys; sys.modules['station'] = None")
        done = carry_out(sweep_command(own, 2, folder, "--scheduler", there.address), tmp_path, environment)

    assert done.returncode == 2
    assert "a worker cannot carry out runs: ModuleNotFoundError" in done.stderr.splitlines()[-1]
    assert rows(folder / "manifest.jsonl") == []
