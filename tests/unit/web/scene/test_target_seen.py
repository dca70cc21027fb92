"""A target is only shown while the tracker sees it, and where there is none nothing is."""

import numpy as np
import pytest
import viser

from core.robot.robot import Array, Robot
from station.control.follow import LOST
from station.control.telemetry import Channels
from station.service.bench import Bench
from station.service.station_file import load_station
from web.scene.history import History
from web.scene.legend import signs
from web.scene.target_mark import TargetMark

PLACE, OFFSET = np.array((0.01, 0.02, 0.2)), np.array((0.0, -0.005, 0.01))


def rows(channels: Channels, begin: float, seconds: float, *, seen: bool) -> Array:
    """Telemetry at 500 Hz, with a frame of the target with every twelfth row, if it is seen."""
    times = begin + 0.002 * np.arange(round(seconds / 0.002))
    made = np.zeros((len(times), len(channels)))
    channels.of(made, "time")[:, 0] = times
    channels.of(made, "target_new")[::12] = float(seen)
    return made


def test_it_is_seen_until_no_frame_has_come_for_too_long(paper_robot: Robot) -> None:
    channels = Channels(paper_robot)
    history = History(channels)
    history.take(rows(channels, 5.0, 1.0, seen=False))
    assert not history.target_seen
    history.take(rows(channels, 6.0, 1.0, seen=True))
    assert history.target_seen
    history.take(rows(channels, 7.0, 0.8 * LOST, seen=False))
    assert history.target_seen
    history.take(rows(channels, 7.0 + 0.8 * LOST, 0.5 * LOST, seen=False))
    assert not history.target_seen


def test_what_was_seen_before_time_began_anew_is_not_seen(paper_robot: Robot) -> None:
    channels = Channels(paper_robot)
    history = History(channels)
    history.take(rows(channels, 100.0, 1.0, seen=True))
    history.take(rows(channels, 0.0, 0.1, seen=False))
    assert not history.target_seen


def test_the_line_leads_to_where_the_tip_should_be_and_only_while_it_is_followed(server: viser.ViserServer) -> None:
    mark = TargetMark(server.scene, 10.0)
    place, line = mark._marker, mark._line
    assert not place.visible
    assert not line.visible
    mark.draw(PLACE, OFFSET)
    assert place.visible
    assert line.visible
    np.testing.assert_allclose(place.position, 10.0 * PLACE)
    np.testing.assert_allclose(line.points, [[PLACE, PLACE + OFFSET]], atol=1e-6)
    mark.draw(PLACE, None)
    assert place.visible
    assert not line.visible
    mark.draw(None, OFFSET)
    assert not place.visible
    assert not line.visible


@pytest.mark.parametrize(("lab", "there"), [("gentle", False), ("breathing", True), ("heartbeat", True)])
def test_the_legend_has_a_target_where_there_is_one(lab: str, there: bool) -> None:
    bench: Bench = load_station(None, {"lab": lab}).bench()
    assert bench.may_see_target is there
    assert any(sign.name.startswith("target") for sign in signs(target=bench.may_see_target)) is there
