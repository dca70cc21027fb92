"""Preset labs: the seed determines the plant, and a bench has small unknown errors."""

import numpy as np
import pytest

from station.config.robots import load_robot
from station.lab.config import load_lab
from station.lab.frictional_plant import true_plant

START = np.array([0.0, 1.5708, -0.1])


@pytest.mark.parametrize(
    "name", ["gentle", "realistic", "distorted", "breathing", "heartbeat", "pointing", "uncalibrated"]
)
def test_preset_lab_draws_the_errors_of_its_tubes_from_the_seed(name: str) -> None:
    robot = load_robot("paper")
    plant = load_lab(name, robot).plant

    drawn = [true_plant(robot.robot(), plant, np.random.default_rng(seed), START).robot for seed in (31, 32)]

    for described, one, other in zip(robot.robot().tubes, drawn[0].tubes, drawn[1].tubes, strict=True):
        assert one.bending_stiffness != other.bending_stiffness
        assert one.bending_stiffness == pytest.approx(described.bending_stiffness, rel=0.08)


def test_realistic_lab_has_unknown_frames_coil_zeros_mountings_and_latency() -> None:
    lab = load_lab("realistic", load_robot("paper"))
    hidden = lab.hidden

    assert min(hidden.registration_translation, hidden.registration_rotation, hidden.coil_misalignment) > 0.0
    assert np.linalg.norm(hidden.coil_offset) > 0.0
    assert min(hidden.rotation_zero, hidden.sensor_mounting) > 0.0
    assert hidden.tracker_latency == pytest.approx(0.2 * lab.tracker.latency)
