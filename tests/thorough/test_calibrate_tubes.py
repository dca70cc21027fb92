"""`ctr-station calibrate tubes` with a robot whose outer tube is nearly straight, and whose tubes can snap."""

import json

import pytest

from tests.harness.root import ROOT


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lab", ["", "[plant]\nvary = 0.05\n"])
def test_tubes_of_a_robot_that_can_snap_are_calibrated(call, write, lab, seed):
    chosen = ["--lab", str(write(lab, "varied"))] if lab else []
    robot = str(ROOT / "tests/harness/straight_outer_tube.toml")

    done = call("calibrate", "tubes", "--robot", robot, "--still", "--seed", str(seed), *chosen, "--json")

    assert done.status == 0, done.err
    assert json.loads(done.out)["held_out_loaded_mean_m"]["calibrated"] < 1e-4
