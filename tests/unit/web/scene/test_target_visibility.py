"""A moving target is shown only while the tracker measures it."""

import numpy as np
import pytest
import viser

from core.robot.robot import Array, Robot
from station.control.follow import TARGET_LOST_S
from station.control.telemetry import Channels
from station.service.rig import Rig
from station.service.station_file import load_station
from web.scene.history import TipTrace
from web.scene.legend import signs
from web.scene.target_mark import TargetMark

PLACE, OFFSET = np.array((0.01, 0.02, 0.2)), np.array((0.0, -0.005, 0.01))


def rows(channels: Channels, begin: float, seconds: float, *, seen: bool) -> Array:
    """Return telemetry at 500 Hz; if `seen`, every twelfth row has a frame of the target."""
    times = begin + 0.002 * np.arange(round(seconds / 0.002))
    made = np.zeros((len(times), len(channels)))
    channels.of(made, "time")[:, 0] = times
    channels.of(made, "target_new")[::12] = float(seen)
    return made


def test_a_target_is_visible_until_no_frame_has_arrived_for_too_long(paper_robot: Robot) -> None:
    channels = Channels(paper_robot)
    history = TipTrace(channels)
    history.take(rows(channels, 5.0, 1.0, seen=False))
    assert not history.target_visible
    history.take(rows(channels, 6.0, 1.0, seen=True))
    assert history.target_visible
    history.take(rows(channels, 7.0, 0.8 * TARGET_LOST_S, seen=False))
    assert history.target_visible
    history.take(rows(channels, 7.0 + 0.8 * TARGET_LOST_S, 0.5 * TARGET_LOST_S, seen=False))
    assert not history.target_visible


def test_a_target_measured_before_a_restart_is_not_visible(paper_robot: Robot) -> None:
    channels = Channels(paper_robot)
    history = TipTrace(channels)
    history.take(rows(channels, 100.0, 1.0, seen=True))
    history.take(rows(channels, 0.0, 0.1, seen=False))
    assert not history.target_visible


def test_the_line_to_the_desired_tip_is_visible_only_while_the_target_is_followed(server: viser.ViserServer) -> None:
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
def test_the_legend_has_a_target_only_in_labs_with_a_target(lab: str, there: bool) -> None:
    bench: Rig = load_station(None, {"lab": lab}).bench()
    assert bench.can_track_target is there
    assert any("target" in sign.name for sign in signs(target=bench.can_track_target)) is there
