"""The report contains all measurements and the computer in one file."""

import platform
from datetime import datetime

from station.benchmarks.report import MEASURES, describe_machine, measured_markdown


def test_report_has_a_row_for_every_figure_of_a_benchmark() -> None:
    written = measured_markdown(
        "here", {"model": {"solves": 3, "solve_us": {"median": 6.5, "p99": 12.0}}, "tick": {"ticks": 7}}
    )

    assert written.index("## `bench model`") < written.index("## `bench tick`")
    assert "| solve_us median | 6.5 |\n| solve_us p99 | 12.0 |\n" in written
    assert "| ticks | 7 |" in written
    assert MEASURES["tick"][0] in written


def test_report_starts_with_machine_and_date() -> None:
    written = measured_markdown(describe_machine(), {})
    assert f"{datetime.now().astimezone():%Y-%m-%d}" in written
    assert f"Python {platform.python_version()}" in written
    assert "processors" in written
    assert "simulated" in written
