"""Preset labs: the seed determines the plant, sensors follow their data sheets, a bench has small unknown errors."""

import re
from collections.abc import Sequence

import numpy as np
import pytest

from station.config.robots import load_robot
from station.lab.config import BaseSensorConfig, load_lab
from station.lab.frictional_plant import true_plant
from station.lab.simulated_netft import SimulatedNetft
from station.lab.wires import MemoryDatagramEnd

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


def reading(minutes: float, config: BaseSensorConfig) -> Sequence[float]:
    box = SimulatedNetft(MemoryDatagramEnd(), config, np.random.default_rng(7))
    box.advance(60.0 * minutes, np.zeros(6))
    found = re.search(r"<runft>(.*)</runft>", (box.page() or b"").decode())
    assert found is not None
    return [int(count) / 1e6 for count in found[1].split(";")]


def test_forces_and_moments_of_a_simulated_sensor_drift_at_the_configured_rates() -> None:
    still = BaseSensorConfig(
        force_noise=0.0, moment_noise=0.0, force_count=0.0, moment_count=0.0, force_offset=0.0, moment_offset=0.0
    )

    # drift of 5 mN and 0.1 N mm per minute
    assert np.abs(reading(10.0, still)) == pytest.approx(3 * [0.05] + 3 * [1e-3], abs=2e-6)
    unmoved = still.model_copy(update={"moment_drift": 0.0})
    assert np.abs(reading(10.0, unmoved)) == pytest.approx(3 * [0.05] + 3 * [0.0], abs=2e-6)


def test_simulated_force_sensor_has_the_resolution_of_its_data_sheet() -> None:
    # The data sheet of the ATI Nano43 SI-18-0.25 states a resolution of 1/256 N and 1/20 N mm.
    values = np.array(reading(7.0, BaseSensorConfig()))

    counts = values / np.repeat([1 / 256, 0.05e-3], 3)
    np.testing.assert_allclose(counts, np.rint(counts), rtol=0, atol=0.02)
