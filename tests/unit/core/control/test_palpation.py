"""A palpation visits its positions in order, and finds the stiffness of springs with known forces and travels."""

import numpy as np
import pytest

from core.control.force_control import Press
from core.control.palpation import Palpation

ALONG = np.array([1.0, 0.0, 0.0])
PLACES = ((0.0, -0.002, 0.0), (0.0, 0.0, 0.0), (0.0, 0.002, 0.0))
#: One visit takes 4 s + 2 * 3 s = 10 s.
PALPATION = Palpation(PLACES, Press(ALONG, 0.05, 0.005, 0.02), Press(ALONG, 0.2, 0.005, 0.02), travel=4.0, dwell=3.0)
TIMES = np.arange(0.0, 30.0, 0.002)
FRAMES = np.arange(0.0, 30.0, 0.025)
#: Stiffness of the spring at each place [N/m], and depth of its surface [m].
SPRINGS, SURFACE = np.array([100.0, 250.0, 400.0]), 0.003


def on_springs(times: np.ndarray, springs: np.ndarray = SPRINGS) -> tuple[np.ndarray, np.ndarray]:
    """Return force [N] and position [m] of a tip that presses on one spring in each visit of 10 s."""
    visit, since = np.floor(times / 10.0).astype(int), times % 10.0
    force = np.where(since < 4.0, 0.0, np.where(since < 7.0, 0.05, 0.2))
    return force, np.where(since < 4.0, 0.0, SURFACE + force / springs[visit])


@pytest.mark.parametrize(("force_error", "tip_error"), [(0.0, 0.0), (0.01, -0.004)])
def test_stiffness_is_that_of_the_spring_at_each_place_and_constant_errors_cancel(force_error, tip_error):
    force, tip = on_springs(TIMES)[0] + force_error, on_springs(FRAMES)[1] + tip_error

    assert PALPATION.stiffness(TIMES, force, FRAMES, tip) == pytest.approx(SPRINGS)


def test_only_the_second_half_of_the_time_for_a_force_counts():
    force, tip = on_springs(TIMES)[0], on_springs(FRAMES)[1]
    early = [
        (times % 10.0 < 5.5 - 1e-9) | ((times % 10.0 > 7.0) & (times % 10.0 < 8.5 - 1e-9)) for times in (TIMES, FRAMES)
    ]
    force[early[0]], tip[early[1]] = 7.0, 7.0

    assert PALPATION.stiffness(TIMES, force, FRAMES, tip) == pytest.approx(SPRINGS)


@pytest.mark.parametrize(
    ("end", "weak", "springs", "unknown"),
    [
        (30.0, (10.0, 20.0), SPRINGS, [False, True, False]),  # a place without contact
        (30.0, (0.0, 0.0), [100.0, 1e4, 400.0], [False, True, False]),  # 0.15 N / 1e4 N/m = 0.015 mm is too small
        (12.0, (0.0, 0.0), SPRINGS, [False, True, True]),  # places after the end of the run
    ],
)
def test_place_without_a_measurable_travel_has_no_estimate(end, weak, springs, unknown):
    times, frames = TIMES[end > TIMES], FRAMES[end > FRAMES]
    force = on_springs(times)[0]
    force[(times >= weak[0]) & (times < weak[1])] = 0.001

    found = PALPATION.stiffness(times, force, frames, on_springs(frames, np.array(springs))[1])

    assert np.isnan(found).tolist() == unknown


def test_tip_presses_at_each_place_with_both_forces():
    for number, place in enumerate(PLACES):
        for since, force in ((4.0, 0.05), (6.9, 0.05), (8.5, 0.2), (9.9, 0.2)):
            setpoint = PALPATION.setpoint(10.0 * number + since)
            assert setpoint.position == pytest.approx(place, abs=1e-12)
            assert setpoint.press is not None
            assert setpoint.press.force == pytest.approx(force)


def test_setpoint_is_continuous_and_its_velocity_is_its_derivative():
    points = [PALPATION.setpoint(time) for time in TIMES]
    position, velocity = (np.array([point[number] for point in points]) for number in (0, 1))

    assert np.gradient(position[:, 1], 0.002) == pytest.approx(velocity[:, 1], abs=1e-5)
    assert np.ptp(position[:, 1]) == pytest.approx(0.004)
    assert (position[:, [0, 2]] == 0.0).all()


def test_desired_force_changes_as_a_ramp_and_is_unknown_between_the_places():
    force = PALPATION.desired_force(TIMES)
    changes = np.abs(np.diff(force[np.isfinite(force) & (TIMES > 4.0)]))

    assert changes.max() < 0.15 / 0.5 * 0.002  # no rise is faster than in half a second
    assert np.isnan(PALPATION.desired_force(np.array([-1.0, 1.0, 3.9, 12.0, 31.5]))).all()
    assert PALPATION.desired_force(np.array([10.5])) == pytest.approx(0.125)  # half of the time of the decrease
