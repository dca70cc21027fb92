"""Error of the force that a motion holds, and stiffness maps against simulated obstacles."""

import math

import numpy as np
import pytest

from station.config.loads import SphereLoad, WallLoad
from station.config.motions import ForceMotion, PalpateMotion
from station.control.telemetry import Channels
from station.recording.press_outcome import (
    PalpationSoFar,
    force_not_reached,
    obstacle_of,
    press_of,
    press_outcome,
    true_stiffness,
)

START = 10.0
#: The motion starts at 10 s.
TIME = np.arange(9.0, 16.0, 0.002)
MOTION = ForceMotion(direction=(0.0, 0.0, -2.0), force=0.2)


def columns(estimated: np.ndarray, true: np.ndarray, known: bool = True) -> dict[str, np.ndarray]:
    """Return the columns of a tip that presses along -z: the force on the tip is along +z."""
    return {
        "time": TIME[:, None],
        "force_filtered": np.outer(estimated, (0.0, 0.0, 1.0)) + np.array([0.3, -0.3, 0.0]),
        "force_true": np.outer(true, (0.0, 0.0, 1.0)),
        "force_variance": np.zeros((len(TIME), 3)),
        "truth_known": np.full((len(TIME), 1), float(known)),
    }


@pytest.mark.parametrize(("end", "text"), [(0.2, ""), (0.11, ""), (0.0, "the desired force 0.2 N was not reached")])
def test_a_force_that_is_not_reached_at_the_end_is_reported(end: float, text: str):
    estimated = np.where(TIME < 12.0, 0.25, end)
    found = force_not_reached(columns(estimated, estimated).__getitem__, MOTION, START)
    assert found.startswith(text)
    assert bool(found) == bool(text)
    assert not text or "at most 0.25 N, at the end 0 N" in found


def test_force_errors_count_from_the_given_time_along_the_direction():
    # 1 N before 12 s; then 0.21 N and 0.17 N alternately, and truly 0.2 N.
    estimated = np.where(TIME < 12.0 - 1e-9, 1.0, np.where(np.arange(len(TIME)) % 2 == 0, 0.21, 0.17))
    true = np.where(TIME < 12.0 - 1e-9, 0.5, 0.2)

    numbers = press_outcome(columns(estimated, true).__getitem__, MOTION, None, START, 2.0)["press"]

    assert numbers["mean_error_N"] == pytest.approx(-0.01, abs=1e-4)
    assert numbers["rms_error_N"] == pytest.approx(math.sqrt((0.01**2 + 0.03**2) / 2.0), abs=1e-4)
    assert (numbers["true_mean_error_N"], numbers["true_rms_error_N"]) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (numbers["max_N"], numbers["true_max_N"]) == pytest.approx((1.0, 0.5))
    real = press_outcome(columns(estimated, true, known=False).__getitem__, MOTION, None, START, 2.0)["press"]
    assert set(real) == {"desired_N", "counted_from_s", "mean_error_N", "rms_error_N", "max_N", "contact_s", "held_s"}
    assert press_outcome(columns(estimated, true).__getitem__, MOTION, None, START, 7.0) == {}  # too short


def test_force_errors_of_a_motion_without_settling_time_count_from_the_desired_force_on():
    estimated = np.where(TIME < START + 2.0 - 1e-9, 0.0, 0.21)

    assert press_outcome(columns(estimated, estimated).__getitem__, MOTION, None, START, 0.0)["press"][
        "mean_error_N"
    ] == pytest.approx(0.01)


def test_settings_of_a_run_give_its_motion_and_its_obstacle():
    settings = {"trajectory": {"kind": "force", "direction": [0, 0, 1], "force": 0.1}, "load": {"kind": "wall"}}

    assert press_of(settings) == ForceMotion(direction=(0.0, 0.0, 1.0), force=0.1)
    assert obstacle_of(settings) == WallLoad()
    assert press_of({"trajectory": {"kind": "hold"}}) is None
    assert obstacle_of({"load": {"kind": "constant", "magnitude": 0.1}}) is None
    assert (press_of({"trajectory": None}), obstacle_of({})) == (None, None)


def test_true_stiffness_of_a_wall_with_a_lump_is_that_of_the_lump_at_each_place():
    motion = PalpateMotion(direction=(1.0, 0.0, 0.0), across=(0.5, 2.0, 0.0), columns=3, rows=2, spacing=0.004)
    wall = WallLoad(
        direction=(-1.0, 0.0, 0.0), distance=0.003, stiffness=150.0, friction=0.3, lump_stiffness=250.0,
        lump_center=(0.0, 0.004, 0.002), lump_radius=0.005,
    )  # fmt: skip
    # The rows are along y; they are at z = -2 mm and 2 mm.
    expected = [
        [150.0 + 250.0 * math.exp(-((y - 0.004) ** 2 + (z - 0.002) ** 2) / 0.005**2) for y in (-0.004, 0.0, 0.004)]
        for z in (-0.002, 0.002)
    ]

    assert true_stiffness(motion, wall) == pytest.approx(np.array(expected), rel=1e-6)


def test_true_stiffness_of_a_sphere_next_to_its_pole_is_that_along_the_direction():
    motion = PalpateMotion(columns=2, rows=1, spacing=0.012, light=0.0999, force=0.1001)
    sphere = SphereLoad(center=(0.0, 0.0, 0.023), radius=0.02, stiffness=200.0)

    # At 6 mm from the axis: f(h) = k (R / r - 1) h with r^2 = h^2 + 36 mm^2, h the height below the center.
    def force(h: float) -> float:
        return 200.0 * (0.02 / math.hypot(h, 0.006) - 1.0) * h

    low, high = 0.015, 0.02
    for _ in range(60):  # bisection: the force decreases with h
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(middle) > 0.1 else (low, middle)
    slope = (force(low - 1e-6) - force(low + 1e-6)) / 2e-6

    assert true_stiffness(motion, sphere) == pytest.approx(slope, rel=1e-3)
    assert slope < 195.0


def test_place_where_the_obstacle_is_out_of_reach_has_no_true_stiffness():
    motion = PalpateMotion(columns=2, rows=1, spacing=0.05)
    assert np.isnan(true_stiffness(motion, SphereLoad(center=(0.025, 0.0, 0.02), radius=0.015))).tolist() == [
        [True, False]
    ]


def test_places_of_a_palpation_become_known_one_after_the_other(paper):
    motion = PalpateMotion(columns=2, rows=2, light=0.1, force=0.2, travel=1.0, dwell=1.0)
    channels, springs, visit = Channels(paper.robot()), np.array([100.0, 200.0, 50.0, 400.0]), 3.0
    times = START + np.arange(0.0, 4 * visit, 0.002)
    place = np.minimum(((times - START) // visit).astype(int), 3)
    force = np.where((times - START) % visit < 2.0, 0.1, 0.2)
    rows = np.zeros((len(times), len(channels)))
    channels.of(rows, "time")[:, 0] = channels.of(rows, "tip_time")[:, 0] = times
    channels.of(rows, "tip_new")[::12] = 1.0
    channels.of(rows, "force_filtered")[:, 2] = -force  # on the tip
    channels.of(rows, "tip_measured")[:, 2] = force / springs[place]
    so_far, found = PalpationSoFar(motion, channels), []
    for block in np.array_split(rows, 48):  # 0.25 s
        so_far.add(block)
        found.append(so_far.stiffness(START))

    assert found[7] == [[None, None], [None, None]]  # after 2 s the first place has its first force only
    assert found[11] == [[100.0, None], [None, None]]
    assert found[23] == [[100.0, 200.0], [None, None]]
    assert found[35] == [[100.0, 200.0], [None, 50.0]]  # the second row is visited backward
    assert found[-1] == [[100.0, 200.0], [400.0, 50.0]]
