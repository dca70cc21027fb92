"""Validity of telemetry for drawing: only current measurements, and a moving target only while it is measured."""

from typing import NamedTuple

import numpy as np
import pytest
import viser

from core.robot.robot import Array, Robot
from station.control.follow import TARGET_LOST_S
from station.control.ring import Timing
from station.control.states import State
from station.control.task import Phase
from station.control.telemetry import Channels, stale_groups
from station.devices.interfaces import Severity
from station.service.station_file import Rig, load_station
from station.service.status import STALE_AFTER_S, StationStatus
from web.scene.history import MAX_TIP_AGE_S, TipTrace, Validity, validity_of
from web.scene.marks import TargetMark, signs

ALL = Validity(row=True, joints=True, tip=True, force=True)


class ReceivedRows(NamedTuple):
    """Received rows, and the station's state."""

    channels: Channels
    history: TipTrace
    rows: Array

    def validity(self, state: State = State.RUNNING, age: float = 0.0) -> Validity:
        row = self.rows[-1]
        values = {name: self.channels.of(row, name) for name in self.channels.groups}
        timing, old = Timing(0, 0, {}, {}, ""), stale_groups(self.channels, row)
        status = StationStatus(state, "", None, False, Phase.NONE, 0.0, age, timing, values, (), (), "", old)
        return validity_of(status, self.history)


def telemetry(robot: Robot, *, held: float = 0.0, sensors: int = 0, stages: int = 0) -> ReceivedRows:
    """Return a second of telemetry rows; in the last `held` [s] the estimates are frozen while raw values continue."""
    channels, random = Channels(robot), np.random.default_rng(0)
    rows = np.zeros((500, len(channels)))
    times = 10.0 + 0.002 * np.arange(500)
    channels.of(rows, "time")[:, 0] = times
    channels.of(rows, "tip_new")[::12] = 1.0
    raw = channels.of(rows, "wrench_raw")
    raw[:] = 1e-3 * random.standard_normal(raw.shape)
    channels.of(rows, "force")[:] = (0.2, 0.0, 0.0) + raw[:, :3]
    still = times > times[-1] - held
    if held:
        channels.of(rows, "tip_new")[still] = 0.0
        channels.of(rows, "estimates_frozen")[still] = 1.0
    channels.of(rows, "trouble")[:] = (stages, 0, sensors)
    history = TipTrace(channels)
    history.take(rows)
    return ReceivedRows(channels, history, rows)


def test_every_measured_value_is_valid(paper_robot: Robot) -> None:
    received = telemetry(paper_robot)
    assert received.validity() == ALL
    assert received.validity().message == ""
    assert received.validity(age=STALE_AFTER_S + 0.1) == Validity(row=False, joints=False, tip=False, force=False)


@pytest.mark.parametrize("state", [State.HOMING, State.FAULT, State.CONNECTED])
def test_frozen_tip_and_force_are_stale_while_telemetry_rows_continue(paper_robot: Robot, state: State) -> None:
    now = telemetry(paper_robot, held=MAX_TIP_AGE_S + 0.05).validity(state)
    assert now == Validity(row=True, joints=True, tip=False, force=False)
    assert now.message == "not measured now: tip, force"


def test_a_fault_with_current_measurements_hides_nothing(paper_robot: Robot) -> None:
    assert telemetry(paper_robot).validity(State.FAULT) == ALL


def test_the_tip_is_current_between_two_frames_of_the_tracker(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, held=0.5 * MAX_TIP_AGE_S).validity().tip


def test_the_values_of_a_faulty_device_are_stale(paper_robot: Robot) -> None:
    assert telemetry(paper_robot, sensors=Severity.HOLD).validity() == ALL._replace(force=False)
    assert telemetry(paper_robot, stages=Severity.FAULT).validity() == ALL._replace(joints=False)
    assert telemetry(paper_robot, sensors=Severity.WARN).validity() == ALL


def test_the_tip_trace_is_empty_where_nothing_is_measured(paper_robot: Robot) -> None:
    assert len(telemetry(paper_robot).history.trace) == 9
    assert len(telemetry(paper_robot, held=0.5).history.trace) == 5


def test_no_value_is_valid_before_the_first_telemetry_row(paper_robot: Robot) -> None:
    history = TipTrace(Channels(paper_robot))
    status = StationStatus(State.OFF, "", None, False, Phase.NONE, 0.0, 9.0, Timing(0, 0, {}, {}, ""), {}, (), (), "")
    assert not any(validity_of(status, history))


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
