"""The control law of the force is stable on any obstacle despite the delay; its bounds, and a lost contact."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from core.control.force_control import (
    CROSSOVER_DELAY,
    NO_CONTACT,
    OVERSHOOT,
    SHARE,
    Agility,
    Contact,
    Press,
    agility,
    press,
    replaced_component,
    without_component,
)

PERIOD, DELAY, GAIN = 0.002, 0.0445, 2.5
#: Compliance of the tubes along the direction [m/N].
SOFTNESS = 0.031
ALONG = np.array([0.6, 0.0, 0.8])
DESIRED = Press(ALONG, 0.2, 0.005, 0.02)
#: The paper's robot along x: 12 mm/s, and five times as much a second.
JOINTS = Agility(0.012, 0.06)


def pressed(
    obstacle: float, wall: Callable[[float], float] = lambda _: 0.004, seconds: float = 20.0, joints: Agility = JOINTS
) -> tuple[np.ndarray, np.ndarray, list[Contact]]:
    """Simulate a tip on an obstacle of a stiffness [N/m] whose surface is at `wall(time)` [m].

    The joints move the free tip to x, with a bounded acceleration. In contact the tubes and the obstacle are springs in
    series. Return the forces, the positions of the tip, and the states.
    """
    state, free, contacts, forces, tips = NO_CONTACT, 0.0, list[Contact](), list[float](), list[float]()
    late, speed = round(DELAY / PERIOD), 0.0
    together = 1.0 / (SOFTNESS + 1.0 / obstacle)
    for tick in range(round(seconds / PERIOD)):
        surface = wall(tick * PERIOD)
        force = max(0.0, together * (free - surface))
        tip = free - SOFTNESS * force
        felt = forces[-late] if len(forces) >= late else 0.0
        state = press(DESIRED, state, -felt * ALONG, SOFTNESS * np.eye(3), tip, joints, GAIN,
                      DELAY, PERIOD)  # fmt: skip
        most = PERIOD * joints.acceleration
        speed += min(max(state.velocity - speed, -most), most)
        free += PERIOD * speed
        forces.append(force)
        tips.append(tip)
        contacts.append(state)
    return np.array(forces), np.array(tips), contacts


@pytest.mark.parametrize("obstacle", [20.0, 1e5])
def test_force_settles_without_oscillation_on_obstacles_of_any_stiffness(obstacle: float) -> None:
    forces, _, _ = pressed(obstacle)
    late = forces[len(forces) // 2 :]

    assert late == pytest.approx(0.2, abs=2e-3)
    assert forces.max() <= (1.0 + OVERSHOOT) * 0.2
    assert np.abs(np.diff(late)).max() < 1e-5  # at rest, without an oscillation


def test_obstacle_that_moves_steadily_is_followed_without_a_force_error() -> None:
    forces, tips, contacts = pressed(1000.0, lambda time: 0.004 - 0.001 * time, 10.0)

    assert forces[-500:] == pytest.approx(0.2, abs=2e-3)
    assert contacts[-1].speed == pytest.approx(-0.001, abs=1e-4)
    assert tips[-1] == pytest.approx(-0.006, abs=1e-3)


def test_tip_without_an_obstacle_approaches_slowly_and_stops_at_the_end_of_its_reach() -> None:
    _, tips, contacts = pressed(1000.0, lambda _: 1.0)

    assert max(state.velocity for state in contacts) <= DESIRED.speed
    assert tips.max() <= DESIRED.reach + 1e-9
    assert tips[-1] == pytest.approx(DESIRED.reach, abs=1e-4)
    assert not contacts[-1].found


def test_tip_that_is_pushed_back_retreats_to_the_other_end_of_its_reach_only() -> None:
    _, tips, contacts = pressed(1e4, lambda time: 0.004 - 0.02 * time, 4.0)

    assert tips.min() > -0.08  # the obstacle pushes on, but the joints do not go further
    assert min(state.velocity for state in contacts) >= -JOINTS.speed


def test_contact_that_is_lost_is_found_again_with_a_bounded_force() -> None:
    forces, _, contacts = pressed(1000.0, lambda time: 0.004 if not 6.0 < time < 9.0 else 0.012, 20.0)

    assert forces[round(6.05 / PERIOD)] == 0.0
    assert contacts[round(6.1 / PERIOD)].speed == 0.0  # known after delay and filter
    found_again = forces[round(6.1 / PERIOD) : round(9.0 / PERIOD)]
    assert found_again.max() <= (1.0 + OVERSHOOT) * 0.2
    assert found_again[-1] == pytest.approx(0.2, abs=5e-3)


@pytest.mark.parametrize("force", [1e6, -1e6])
def test_wrong_force_moves_the_joints_at_a_bounded_speed(force: float) -> None:
    state = NO_CONTACT
    for _ in range(2000):
        state = press(DESIRED, state, force * ALONG, SOFTNESS * np.eye(3), 0.0, JOINTS, GAIN, DELAY, PERIOD)
        assert abs(state.velocity) <= JOINTS.speed
        assert abs(state.speed) <= JOINTS.speed


def test_obstacle_that_is_too_quick_for_the_joints_keeps_contact_with_a_smaller_error_than_joints_at_rest() -> None:
    def wall(time: float) -> float:
        return 0.004 + 0.005 * math.sin(2.0 * math.pi * time)

    forces, _, _ = pressed(1000.0, wall)
    late = forces[len(forces) // 2 :]
    at_rest = 0.005 / (SOFTNESS + 1e-3) / math.sqrt(2.0)

    assert math.sqrt(((late - 0.2) ** 2).mean()) < at_rest
    assert late.mean() == pytest.approx(0.2, abs=0.01)
    assert late.min() > 0.0


def test_law_recovers_from_a_wrong_force_within_seconds() -> None:
    state = NO_CONTACT
    for force in [-1e6] * 50 + [-0.1] * 3500:
        state = press(DESIRED, state, force * ALONG, SOFTNESS * np.eye(3), 0.0, JOINTS, GAIN, DELAY, PERIOD)
    needed = CROSSOVER_DELAY / DELAY * SOFTNESS * math.sqrt(2.0 * state.rate_square)

    assert needed < JOINTS.acceleration


def test_agility_is_the_share_of_the_joint_that_a_straight_motion_moves_fastest() -> None:
    jacobian = np.array([[0.05, 0.05, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 1.0]])
    # Along y both rotations turn, against each other: 0.02 m/rad at 0.35 rad/s.
    found = agility(jacobian, np.array([0.35, 0.35, 0.02]), np.array([1.75, 1.75, 0.1]), np.array([0.0, 1.0, 0.0]))

    assert found.speed == pytest.approx(SHARE * 0.007)
    assert found.acceleration == pytest.approx(SHARE * 0.035)


def test_components_along_a_direction_are_removed_and_replaced() -> None:
    vector = np.array([1.0, 2.0, 3.0])

    assert without_component(vector, ALONG) @ ALONG == pytest.approx(0.0, abs=1e-12)
    replaced = replaced_component(vector, ALONG, -0.5)
    assert replaced @ ALONG == pytest.approx(-0.5)
    assert replaced - (replaced @ ALONG) * ALONG == pytest.approx(without_component(vector, ALONG))
