"""A sweep: what is swept, the same runs as alone."""

import os

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.sweep import Job, Outcome, jobs, spreads, sweep, sweep_summary
from station.experiments.sweep_settings import settings
from tests.harness.cases import a_run


@pytest.fixture
def own(write, short):
    """A second at rest, two cases."""
    return str(write(short + "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"))


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("controller.k1=-1", ["own.toml", "case 'one'", "K1 = -1 1/s"]),
        ("controller.k9=1", ["own.toml", "unknown key 'controller.k9'"]),
        ("lab=nowhere", ["'nowhere' is not one of the labs"]),
        ("duration=nan", ["duration = nan"]),
    ],
)
def test_every_setting_is_checked_before_anything_runs(own, option, said):
    with pytest.raises(ConfigError) as refused:
        jobs(own, settings([option]), range(2))
    for part in said:
        assert part in str(refused.value)


def test_an_unknown_case_is_refused_with_those_that_there_are(own):
    with pytest.raises(ConfigError, match="--case three: the cases are one, two"):
        jobs(own, [()], range(1), "three")


def test_settings_go_on_top_of_every_case(own):
    listed = jobs(own, settings(["controller.feedforward=false", "controller.k1=3"]), range(2))

    assert [(job.case.name, job.seed) for job in listed] == [("one", 0), ("one", 1), ("two", 0), ("two", 1)]
    assert {(job.case.file.controller.feedforward, job.case.file.controller.k1) for job in listed} == {(False, 3.0)}


def without_clock(numbers):
    return {key: value for key, value in numbers.items() if key != "wall_s"}


def test_runs_of_a_sweep_are_bit_for_bit_those_of_single_runs(own):
    listed = jobs(own, settings(["duration=0.4"]), [3, 4], "two")
    told: list[int] = []
    before = {name: value for name, value in os.environ.items() if "THREADS" in name}
    outcomes = sweep(listed, 2, told.append)

    assert [outcome.job.seed for outcome in outcomes] == [3, 4]
    assert told[-1] == 2
    for outcome, job in zip(outcomes, listed, strict=True):
        alone = summarise(a_run(job.case, job.seed))
        assert alone["completed"]
        assert without_clock(outcome.numbers) == without_clock(alone)
    assert outcomes[0].numbers["rms_error_mm"] != outcomes[1].numbers["rms_error_mm"]
    assert {name: value for name, value in os.environ.items() if "THREADS" in name} == before


def made_up(own: str, values: list[float], broken: int = -1) -> list[Outcome]:
    case = load_experiment(own).cases[0]
    return [
        Outcome(
            Job((("controller.k1", 1),), case, seed),
            {
                "completed": seed != broken,
                "cause": "",
                "wall_s": 1.0,
                "rms_error_mm": [value, 2.0, 3.0],
                "step": {"rate": value},
            },
        )
        for seed, value in enumerate(values)
    ]


def test_spreads_are_percentiles_over_the_completed_runs(own):
    values = [5.0, 1.0, 2.0, 4.0, 3.0, 100.0]
    found = spreads(made_up(own, values, broken=5))
    x = found["rms_error_mm.x"]

    assert (x.median, x.worst) == (3.0, 5.0)
    assert (x.p5, x.p95) == (pytest.approx(np.quantile([1, 2, 3, 4, 5], 0.05)), pytest.approx(4.8))
    assert found["step.rate"].median == 3.0
    assert found["rms_error_mm.y"] == (2.0, 2.0, 2.0, 2.0)
    assert "wall_s" not in found
    assert "completed" not in found


def test_a_sweep_with_a_run_that_did_not_complete_is_not_complete(own):
    outcomes = made_up(own, [1.0, 2.0, 3.0], broken=1)
    summary = sweep_summary(load_experiment(own), [outcome.job for outcome in outcomes], outcomes, 1.0)

    assert not summary["completed"]
    assert summary["settings"][0]["runs"] == 3
    assert summary["settings"][0]["completed"] == 2
    assert [run["seed"] for run in summary["runs"]] == [0, 1, 2]
    assert summary["runs"][0]["setting"] == {"controller.k1": 1}
