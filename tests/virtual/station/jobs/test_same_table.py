"""A sweep gives the same table wherever it runs, and however often it is killed and continued."""

import importlib.util
import json

import pytest

from station.experiments.experiment import load_experiment
from station.experiments.sweep import run_job, sweep_summary
from station.experiments.sweep_plan import jobs, plan_of, settings
from tests.tools.killed_sweep import DURATIONS, experiment_in, kill_process, sweep_command, swept, table

#: Number of runs; `tests/thorough/test_sweep_on_dask.py` has more, on a cluster whose scheduler survives its client.
RUNS = 6


def alone(experiment):
    """Return the table of the runs in this process, one after the other."""
    listed = jobs(str(experiment), settings([DURATIONS]), range(RUNS // 2))
    rows = [run_job(job, lambda _: None) for job in listed]
    assert [row["completed"] for row in rows] == [True] * RUNS
    return table(json.loads(json.dumps(sweep_summary(plan_of(load_experiment(str(experiment)), listed), rows, 0.0))))


def test_a_sweep_on_two_processes_that_is_killed_and_continued_has_the_table_of_single_runs(tmp_path):
    experiment = experiment_in(tmp_path)
    found = swept(sweep_command(experiment, RUNS, tmp_path / "here", "--jobs", "2"), RUNS, kill_client=True)
    assert RUNS // 2 <= found.killed_at[0] < RUNS
    assert found.table == alone(experiment)


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="the extra dask is not installed")
def test_a_sweep_on_two_dask_workers_of_which_one_is_killed_has_the_table_of_single_runs(tmp_path):
    experiment = experiment_in(tmp_path)
    command = sweep_command(experiment, RUNS, tmp_path / "here", "--jobs", "2", "--scheduler", "local")
    found = swept(command, RUNS, kill_worker=kill_process)
    assert RUNS // 3 <= found.killed_at[0] < RUNS
    assert "2 workers; dashboard: http://127.0.0.1:" in found.printed
    assert found.table == alone(experiment)
