"""Stale values are null, in the status and in the telemetry stream."""

from collections.abc import Iterator

import numpy as np
import pytest

from core.robot.robot import Array
from station.control.task import Phase
from station.control.telemetry import DIRECTION_CHANNELS, SENSOR_CHANNELS, TRACKER_CHANNELS, TRUTH_CHANNELS
from station.devices.interfaces import Severity
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from web.api.control import SCALAR_GROUPS, STREAMED_GROUPS, sample_out
from web.api.rig import devices_out


@pytest.fixture(scope="module")
def service() -> Iterator[StationService]:
    supervisor = Supervisor(load_station(None).bench())
    yield StationService(supervisor)
    supervisor.close()


VECTORS = frozenset(STREAMED_GROUPS) - set(SCALAR_GROUPS)


def groups_with_values(service: StationService, row: Array) -> frozenset[str]:
    """Return the groups with a value in the stream; status and raw values agree."""
    supervisor = service.supervisor
    supervisor.ring.write(row)
    sample = sample_out(service, row, 0, None)
    fresh = frozenset(group for group in VECTORS if sample[group] is not None)
    assert VECTORS - supervisor.status().stale_groups == fresh
    assert any(name.startswith("force.") for name in devices_out(service).raw) == ("force" in fresh)
    return fresh


@pytest.fixture
def row(service: StationService) -> Array:
    channels = service.supervisor.channels
    row = np.ones(len(channels))
    for group in ("trouble", "estimates_frozen"):
        channels.of(row, group)[:] = 0.0
    channels.of(row, "phase")[:] = Phase.MOVING
    return row


def test_all_telemetry_groups_have_values_while_all_are_current(service: StationService, row: Array) -> None:
    assert groups_with_values(service, row) == VECTORS


def test_a_row_with_frozen_estimates_has_only_values_that_are_read(service: StationService, row: Array) -> None:
    service.supervisor.channels.of(row, "estimates_frozen")[:] = 1.0
    assert groups_with_values(service, row) == {"joints", "trouble"}


def test_the_start_of_a_contact_is_null_while_estimates_are_frozen(service: StationService, row: Array) -> None:
    service.supervisor.channels.of(row, "contact_start")[:] = 12.5
    assert sample_out(service, row, 0, None)["contact_start"] == 12.5
    service.supervisor.channels.of(row, "estimates_frozen")[:] = 1.0
    assert sample_out(service, row, 0, None)["contact_start"] is None


@pytest.mark.parametrize(("place", "old"), [(1, TRACKER_CHANNELS), (2, SENSOR_CHANNELS)])
def test_the_telemetry_values_of_a_silent_device_are_null(
    service: StationService, row: Array, place: int, old: frozenset[str]
) -> None:
    troubles = service.supervisor.channels.of(row, "trouble")
    troubles[place] = Severity.WARN
    assert groups_with_values(service, row) == VECTORS
    troubles[place] = Severity.HOLD
    assert groups_with_values(service, row) == VECTORS - old


def test_ground_truth_is_null_where_it_is_unknown(service: StationService, row: Array) -> None:
    service.supervisor.channels.of(row, "truth_known")[:] = 0.0
    assert groups_with_values(service, row) == VECTORS - TRUTH_CHANNELS
    assert sample_out(service, row, 0, None)["phase"] == "moving"


def test_tip_directions_are_null_where_the_direction_is_not_controlled(service: StationService, row: Array) -> None:
    for group in DIRECTION_CHANNELS:
        service.supervisor.channels.of(row, group)[:] = 0.0
    assert groups_with_values(service, row) == VECTORS - set(DIRECTION_CHANNELS)
