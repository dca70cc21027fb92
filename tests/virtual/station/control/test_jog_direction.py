"""A jog of the direction turns the tip at constant position; it is refused if the direction is not controlled."""

import numpy as np
import pytest

from station.control.states import RefusedError, State
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation, usual_case

RATE = np.array([0.0, 0.1, 0.0])  #: angular velocity of the jog [rad/s]


def angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def test_jog_in_direction_turns_the_tip_while_renewed_at_constant_position() -> None:
    station = VirtualStation(a_case("points", "pointing_alone")).ready()
    station.seconds(1.0)
    before, place = station.of("direction_true")[-1], station.of("tip_true")[-1]
    for _ in range(10):
        station.loop.jog(station.now, "direction", RATE)
        station.seconds(0.1)
    desired, true = station.of("direction_desired")[-1], station.of("direction_true")[-1]

    # The jog turns about y, and only the component normal to the tip turns it. The tip started at the measured
    # direction, with an error of up to 5 mrad.
    expected = 0.1 * np.linalg.norm(np.cross([0.0, 1.0, 0.0], before))
    assert angle(desired, before) == pytest.approx(expected, abs=0.03)
    assert np.cross(before, desired)[1] > 0.0
    assert angle(desired, true) < 0.03
    station.becomes(State.READY)
    assert np.linalg.norm(station.of("tip_true")[-1] - place) < 4e-3


def test_jog_in_direction_is_refused_when_only_the_position_is_controlled() -> None:
    station = VirtualStation(usual_case()).ready()
    with pytest.raises(RefusedError, match="direction is not controlled here"):
        station.loop.jog(station.now, "direction", RATE)
    assert station.state is State.READY
