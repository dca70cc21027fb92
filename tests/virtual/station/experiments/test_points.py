"""Six joints on one serial chain: the tip follows a circle with a constant direction."""

import numpy as np
import pytest

from station.experiments.results import angles, summarise
from tests.harness.cases import a_case, a_run


@pytest.fixture(scope="module")
def pointing():
    return a_run(a_case("points", "pointing", duration=5.0), 1)


def test_the_tip_keeps_its_direction_on_a_circle_under_load(pointing):
    assert pointing.completed, pointing.cause
    found = summarise(pointing)
    assert found["true_p95_distance_mm"] < 1.0
    assert found["true_direction_error_deg"]["p95"] < 1.0
    assert set(found["smallest"]) == {"stability", "room_of_half_travel", "tube_order_mm"}


def test_a_recording_has_the_measured_observed_desired_and_true_tip_direction(pointing):
    def of(group: str) -> np.ndarray:
        return pointing.channels.of(pointing.rows, group)

    for group in ("direction_measured", "direction_observed", "direction_desired", "direction_true"):
        np.testing.assert_allclose(np.linalg.norm(of(group), axis=1), 1.0, atol=1e-6)
    measured, observed = (angles(of(f"direction_{how}"), of("direction_true")) for how in ("measured", "observed"))
    assert np.sqrt(np.mean(observed**2)) < np.sqrt(np.mean(measured**2))
    assert not np.ptp(of("direction_desired"), axis=0).any()


def test_each_of_six_axes_receives_its_velocity_commands_over_one_serial_line(pointing):
    """The line carries 960 bytes a second; a command and its reply have six bytes each; polls take the rest."""
    assert len(pointing.rates) == 6
    for rates in pointing.rates.values():
        assert 20.0 < rates["velocities_per_s"] < 26.0


def test_a_recording_of_a_position_task_has_no_desired_tip_direction():
    recording = a_run(a_case("points", "position", duration=0.5), 1)
    assert not recording.channels.of(recording.rows, "direction_desired").any()
    assert "true_direction_error_deg" not in summarise(recording)
    assert "true_p95_distance_mm" in summarise(recording)
