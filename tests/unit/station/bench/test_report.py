"""What was measured goes into one file, with the machine and without a gap."""

import platform
from datetime import datetime

from station.bench.report import MEASURES, machine, text


def test_every_figure_is_a_row_under_its_benchmark() -> None:
    written = text("here", {"model": {"solves": 3, "solve_us": {"median": 6.5, "p99": 12.0}}, "tick": {"ticks": 7}})

    assert written.index("## `bench model`") < written.index("## `bench tick`")
    assert "| solve_us median | 6.5 |\n| solve_us p99 | 12.0 |\n" in written
    assert "| ticks | 7 |" in written
    assert MEASURES["tick"][0] in written


def test_machine_and_date_stand_above_them() -> None:
    written = text(machine(), {})
    assert f"{datetime.now().astimezone():%Y-%m-%d}" in written
    assert f"Python {platform.python_version()}" in written
    assert "processors" in written
    assert "simulated" in written
