"""The reported progress of homing matches the motion of the units."""

import pytest

from station.config.robots import RobotFile
from station.devices.interfaces import Condition
from tests.harness.zaber_bench import Bench


def test_homing_progress_names_each_axis_with_the_correct_time(paper: RobotFile) -> None:
    bench = Bench(paper).connect()
    assert "homing" not in bench.stages.details()
    bench.stages.home(bench.now)
    start, reports = bench.now, [bench.stages.details()["homing"]]
    while bench.stages.condition is Condition.HOMING:
        bench.run(0.5, until=lambda: bench.stages.condition is not Condition.HOMING)
        if "homing" in (details := bench.stages.details()):
            reports.append(details["homing"])

    assert bench.stages.condition is Condition.CONNECTED
    assert list(dict.fromkeys(one["joint"] for one in reports)) == [
        "inner_translation",
        "outer_rotation",
        "inner_rotation",
    ]
    assert [one["number"] for one in reports] == sorted(one["number"] for one in reports)
    assert reports[0]["exact"]
    # velocity ramps and the reading of settings take additional time
    assert reports[0]["left_s"] == pytest.approx(bench.now - start, abs=6.0)
    assert "homing" not in bench.stages.details()
