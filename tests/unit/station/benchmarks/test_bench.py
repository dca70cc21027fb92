"""The benchmark measures a warm model near the exact rod and reports the documented names."""

import io

from rich.console import Console

from station.benchmarks import bench
from station.benchmarks.bench import VECTOR_EPISODES, gym


def test_model_benchmark_reports_times_and_the_distance_from_the_exact_rod():
    result = bench.model(solves=400, tubes=1)

    assert result["solves"] == 400
    assert 0.0 < result["solve_us"]["median"] <= result["solve_us"]["p99"]
    assert 1.0 <= result["passes"] <= 4.0
    # The published error of 10 mm sub-links is 0.041 mm in the mean and 0.114 mm at the worst of 20 000 poses.
    assert 0.0 < result["accuracy_mm"]["mean"] < 0.08
    for start in ("cold", "warm"):
        assert result["many"][start]["per_core_and_s"] > 0
        assert next(iter(result["many"][start]["per_s_by_cores"])) == "1"
    assert list(result["many"]["warm_per_core_and_s_by_tubes"]) == ["1"]
    assert result["accuracy_mm"]["mean"] <= result["accuracy_mm"]["max"] < 0.114


def test_model_benchmark_runs_with_few_solves():
    assert bench.model(solves=3, tubes=0)["solves"] == 3


def test_benchmark_table_shows_every_figure():
    text = io.StringIO()
    Console(file=text, width=100).print(bench.table("model", {"solve_us": {"median": 7.25, "p99": 9.5}, "passes": 1.5}))

    for shown in ("bench model", "solve_us median", "7.25", "solve_us p99", "9.5", "passes", "1.5"):
        assert shown in text.getvalue()


def test_gym_benchmark_steps_single_and_vector_environments():
    result = gym(seconds=0.05)

    assert list(result) == ["CtrReach-v0", "CtrTrack-v0"]
    for rates in result.values():
        assert list(rates) == ["single", f"{VECTOR_EPISODES} at once"]
        for rate in rates.values():
            assert rate["per_s"] > 0
            assert rate["per_core_and_s"] > 0
