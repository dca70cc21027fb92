"""The benchmark measures a warm model near the exact rod and reports the documented names."""

import io

from rich.console import Console

from station.benchmarks.model import model
from station.benchmarks.tables import table


def test_model_benchmark_reports_times_and_the_distance_from_the_exact_rod():
    result = model(solves=400)

    assert result["solves"] == 400
    assert 0.0 < result["solve_us"]["median"] <= result["solve_us"]["p99"]
    assert 1.0 <= result["passes"] <= 4.0
    # The published error of 10 mm sub-links is 0.041 mm in the mean and 0.114 mm at the worst of 20 000 poses.
    assert 0.0 < result["accuracy_mm"]["mean"] < 0.08
    assert result["accuracy_mm"]["mean"] <= result["accuracy_mm"]["max"] < 0.114


def test_benchmark_table_shows_every_figure():
    text = io.StringIO()
    Console(file=text, width=100).print(table("model", {"solve_us": {"median": 7.25, "p99": 9.5}, "passes": 1.5}))

    for shown in ("bench model", "solve_us median", "7.25", "solve_us p99", "9.5", "passes", "1.5"):
        assert shown in text.getvalue()
