"""Sweeps: their settings, runs equal to single runs, and statistics."""

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.sweep import run_job, spreads, sweep_summary
from station.experiments.sweep_plan import jobs, nested, plan_of, settings
from station.jobs.manifest import Row, difference
from station.recording.metadata import versions
from tests.harness.cases import a_run


@pytest.fixture
def own(write, short):
    """Return an experiment of one second at rest with two cases."""
    return str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("controller.k1=-1", ["own.toml", "case 'one'", "K1 = -1 1/s"]),
        ("controller.k9=1", ["own.toml", "unknown key 'controller.k9'"]),
        ("lab=nowhere", ["'nowhere' is not one of the labs"]),
        ("duration=nan", ["duration = nan"]),
    ],
)
def test_every_setting_of_a_sweep_is_checked_before_anything_runs(own, option, message):
    with pytest.raises(ConfigError) as refused:
        jobs(own, settings([option]), range(2))
    for part in message:
        assert part in str(refused.value)


def test_a_sweep_of_an_unknown_case_is_refused_with_the_list_of_cases(own):
    with pytest.raises(ConfigError, match="--case three: the cases are one, two"):
        jobs(own, [()], range(1), "three")


def test_sweep_settings_apply_to_every_case(own):
    listed = jobs(own, settings(["controller.feedforward=false", "controller.k1=3"]), range(2))

    assert [(job.case.name, job.seed) for job in listed] == [("one", 0), ("one", 1), ("two", 0), ("two", 1)]
    assert {(job.case.file.controller.feedforward, job.case.file.controller.k1) for job in listed} == {(False, 3.0)}


def without_clock(row: Row) -> Row:
    return {key: value for key, value in row.items() if key != "wall_s"}


def test_runs_of_a_sweep_are_bit_for_bit_those_of_single_runs(own):
    listed = jobs(own, settings(["duration=0.4"]), [3, 4], "two")
    rows = [run_job(job, lambda _: None) for job in listed]

    assert [row["seed"] for row in rows] == [3, 4]
    for row, job in zip(rows, listed, strict=True):
        alone = summarise(a_run(job.case, job.seed))
        assert alone["completed"]
        about = {"run": job.run, "setting": {"duration": 0.4}, "case": "two", "seed": job.seed, "versions": versions()}
        assert without_clock(row) == {**about, **without_clock(alone)}
    assert rows[0]["rms_error_mm"] != rows[1]["rms_error_mm"]


def test_a_sweep_run_that_raises_an_exception_is_a_row_with_the_reason(own):
    job = jobs(own, settings(["duration=0.2"]), range(1))[0]
    row = run_job(job._replace(case=job.case._replace(start=np.zeros(7))), lambda _: None)

    about = {"run": 0, "setting": {"duration": 0.2}, "case": "one", "seed": 0, "versions": versions()}
    assert row == {**about, "completed": False, "cause": row["cause"]}
    assert "Error: " in row["cause"]


def synthetic_rows(values: list[float], broken: int = -1) -> list[Row]:
    """Return synthetic rows of the first setting and case."""
    about = {"setting": {"controller.k1": 1}, "case": "one", "versions": {}, "cause": "", "wall_s": 1.0}
    return [
        about
        | {"run": seed, "seed": seed, "completed": seed != broken, "rms_error_mm": [value, 2.0, 3.0]}
        | {"step": {"rate": value}}
        for seed, value in enumerate(values)
    ]


def test_spreads_of_a_sweep_are_percentiles_over_the_completed_runs():
    values = [5.0, 1.0, 2.0, 4.0, 3.0, 100.0]
    found = spreads(synthetic_rows(values, broken=5))
    x = found["rms_error_mm.x"]

    assert (x.median, x.worst) == (3.0, 5.0)
    assert (x.p5, x.p95) == (pytest.approx(np.quantile([1, 2, 3, 4, 5], 0.05)), pytest.approx(4.8))
    assert found["step.rate"].median == 3.0
    assert found["rms_error_mm.y"] == (2.0, 2.0, 2.0, 2.0)
    assert set(found) == {"rms_error_mm.x", "rms_error_mm.y", "rms_error_mm.z", "step.rate"}


def test_a_sweep_with_a_run_that_did_not_complete_is_not_complete(own):
    listed = jobs(own, settings(["controller.k1=1"]), range(3), "one")
    plan, rows = plan_of(load_experiment(own), listed), synthetic_rows([1.0, 2.0, 3.0], broken=1)
    summary = sweep_summary(plan, rows, 1.0)

    assert not summary["completed"]
    assert summary["settings"][0]["runs"] == 3
    assert summary["settings"][0]["completed"] == 2
    assert [run["seed"] for run in summary["runs"]] == [0, 1, 2]
    assert summary["runs"][0]["setting"] == {"controller.k1": 1}
    assert not sweep_summary(plan, rows[:2], 1.0)["completed"]
    assert sweep_summary(plan, synthetic_rows([1.0, 2.0, 3.0]), 1.0)["completed"]


def test_a_sweep_plan_depends_on_the_contents_of_its_files_and_not_on_their_folder(own, write, tmp_path, monkeypatch):
    lab = write('title = "a lab"\n', "lab")

    def plan(name: str = own):
        chosen = settings([f"lab='{lab}'"])
        return plan_of(load_experiment(name, nested(chosen[0])), jobs(name, chosen, range(2)))

    first = plan().model_dump()
    monkeypatch.chdir(tmp_path)
    assert difference(first, plan("own.toml").model_dump()) == ""
    write('title = "a lab"\n[tracker]\nnoise = 0.3e-3\n', "lab")
    assert difference(first, plan().model_dump()) == "contents has changed since"
