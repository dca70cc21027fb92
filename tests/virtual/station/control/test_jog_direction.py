"""Turning the tip by hand: it points elsewhere and stays where it is; where that is not controlled it is refused."""

import numpy as np
import pytest

from station.control.states import RefusedError, State
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation, usual_case

RATE = np.array([0.0, 0.1, 0.0])  #: rad/s


def angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def test_the_tip_turns_as_long_as_it_is_asked_and_its_place_is_kept() -> None:
    station = VirtualStation(a_case("points", "pointing_alone")).ready()
    station.seconds(1.0)
    before, place = station.of("direction_true")[-1], station.of("tip_true")[-1]
    for _ in range(10):
        station.loop.jog(station.now, "direction", RATE)
        station.seconds(0.1)
    desired, true = station.of("direction_desired")[-1], station.of("direction_true")[-1]

    # About y, of which only what is across the tip turns it; it began where the tip was seen, to 5 mrad.
    expected = 0.1 * np.linalg.norm(np.cross([0.0, 1.0, 0.0], before))
    assert angle(desired, before) == pytest.approx(expected, abs=0.03)
    assert np.cross(before, desired)[1] > 0.0
    assert angle(desired, true) < 0.03
    station.becomes(State.READY)
    assert np.linalg.norm(station.of("tip_true")[-1] - place) < 4e-3


def test_where_only_the_place_is_controlled_it_is_refused() -> None:
    station = VirtualStation(usual_case()).ready()
    with pytest.raises(RefusedError, match="where the tip points is not controlled here"):
        station.loop.jog(station.now, "direction", RATE)
    assert station.state is State.READY
