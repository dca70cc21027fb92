"""Every preset robot runs the long calibrations, which need known weights."""

import json

import pytest

from tests.virtual.station.cli.test_every_robot import ROBOTS


@pytest.mark.parametrize("seed", ["0", "1"])
@pytest.mark.parametrize("what", ["force", "tubes"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_is_calibrated_with_weights(call, robot, what, seed):
    done = call("calibrate", what, "--robot", robot, "--still", "--effort", "0.5", "--seed", seed, "--out", "found",
                "--json")  # fmt: skip
    assert done.status == 0, done.err
    assert all(each["error_N"] < 0.02 for each in json.loads(done.out)["weights"])
