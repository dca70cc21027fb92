"""What the stages tell of their homing is what their units do."""

import pytest

from station.config.robots import RobotFile
from station.devices.interfaces import Condition
from tests.harness.zaber_bench import Bench


def test_every_axis_is_told_in_its_turn_and_the_time_is_right(paper: RobotFile) -> None:
    bench = Bench(paper).connect()
    assert "homing" not in bench.stages.details()
    bench.stages.home(bench.now)
    begun, told = bench.now, [bench.stages.details()["homing"]]
    while bench.stages.condition is Condition.HOMING:
        bench.run(0.5, until=lambda: bench.stages.condition is not Condition.HOMING)
        if "homing" in (details := bench.stages.details()):
            told.append(details["homing"])

    assert bench.stages.condition is Condition.CONNECTED
    assert list(dict.fromkeys(one["joint"] for one in told)) == [
        "inner_translation",
        "outer_rotation",
        "inner_rotation",
    ]
    assert [one["number"] for one in told] == sorted(one["number"] for one in told)
    assert told[0]["exact"]
    # ramps, and settings that are read back, come on top of the ways
    assert told[0]["left_s"] == pytest.approx(bench.now - begun, abs=6.0)
    assert "homing" not in bench.stages.details()
