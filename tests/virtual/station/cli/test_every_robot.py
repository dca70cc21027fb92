"""Every preset robot runs every calibration and analysis; robots with a nearly straight outer tube do, too."""

import json
import math

import pytest

from core.calibration.quantities import reference_tube
from station.config.robots import load_robot
from station.config.strict import PRESETS
from tests.harness.robots import straight_outer

ROBOTS = sorted(path.stem for path in (PRESETS / "robots").glob("*.toml"))


@pytest.mark.parametrize("what", ["axes", "tracker"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_is_calibrated_on_a_simulated_bench_at_rest(call, robot, what):
    done = call("calibrate", what, "--robot", robot, "--still", "--effort", "0.5", "--out", "found", "--json")

    assert done.status == 0, done.err
    if what == "axes":  # the uncalibrated bench has no reversed axis
        assert set(json.loads(done.out)["signs"].values()) == {1.0}


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_has_a_workspace(call, robot):
    done = call("workspace", robot, "--poses", "40", "--out", "found", "--json")
    assert done.status == 0, done.err


@pytest.mark.parametrize("curvature", [0.0, 0.05])
@pytest.mark.parametrize("preset", ["paper", "three_tubes"])
def test_signs_of_a_robot_with_a_nearly_straight_outer_tube_are_found_where_the_tip_shows_them(
    call, write, preset, curvature
):
    """A straight tube looks the same at every angle: only the sign of its own rotation cannot be measured."""
    robot = write(straight_outer(preset, curvature))
    lab = write('[hidden]\nmirrored = ["inner_rotation"]\n', "mirrored")

    done = call("calibrate", "axes", "--robot", str(robot), "--lab", str(lab), "--still", "--out", "found", "--json")

    assert done.status == 0, done.err
    numbers = json.loads(done.out)
    signs = numbers["signs"]
    assert signs.pop("outer_rotation") == 0.0
    signs.pop("outer_translation", None)
    assert signs.pop("inner_rotation") == -1.0
    assert set(signs.values()) <= {1.0}
    assert any("check them by eye" in finding for finding in numbers["findings"])


@pytest.mark.parametrize(("preset", "curved"), [("paper", 0), ("three_tubes", 1)])
def test_the_outermost_curved_tube_defines_the_frame(write, preset, curved):
    assert reference_tube(load_robot(str(write(straight_outer(preset, 0.05)))).robot()) == curved
    assert reference_tube(load_robot(preset).robot()) == curved + 1


def test_tubes_and_frames_are_calibrated_although_the_outer_tube_is_straight(call, write):
    robot = write(straight_outer("paper", 0.0))
    done = call("calibrate", "tubes", "--robot", str(robot), "--still", "--effort", "0.5", "--out", "found", "--json")

    assert done.status == 0, done.err
    numbers = json.loads(done.out)
    assert not any("outer zero_angle" in name for name in numbers["parameters"])
    assert math.degrees(numbers["parameters"]["frame rotation z"]["standard_deviation"]) < 0.2
    held_out = numbers["held_out_loaded_mean_m"]
    assert held_out["calibrated"] < 0.3 * held_out["believed"]
