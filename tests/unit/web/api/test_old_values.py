"""Stale values are null, in the status and in the telemetry stream."""

from collections.abc import Iterator

import numpy as np
import pytest

from core.robot.robot import Array
from station.control.task import Phase
from station.devices.interfaces import Severity
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from web.api.control import SCALAR_GROUPS, STREAMED_GROUPS, sample_out
from web.api.rig import devices_out


@pytest.fixture(scope="module")
def supervisor() -> Iterator[Supervisor]:
    supervisor = Supervisor(load_station(None).bench())
    yield supervisor
    supervisor.close()


VECTORS = frozenset(STREAMED_GROUPS) - set(SCALAR_GROUPS)
BY_TRACKER = {"tip_measured", "direction_measured", "target_measured"}
BY_SENSORS = {"force", "force_filtered", "force_variance", "deflection", "deflection_filtered", "deflection_rate"}
TRUE = {"tip_true", "direction_true", "target_true"}
DIRECTIONS = {"direction_measured", "direction_observed", "direction_desired", "direction_true"}


def groups_with_values(supervisor: Supervisor, row: Array) -> frozenset[str]:
    """Return the groups with a value in the stream; status and raw values agree."""
    supervisor.ring.write(row)
    sample = sample_out(supervisor, row, 0, None)
    fresh = frozenset(group for group in VECTORS if sample[group] is not None)
    assert VECTORS - supervisor.status().stale_groups == fresh
    assert any(name.startswith("force.") for name in devices_out(supervisor).raw) == ("force" in fresh)
    return fresh


@pytest.fixture
def row(supervisor: Supervisor) -> Array:
    channels = supervisor.channels
    row = np.ones(len(channels))
    for group in ("trouble", "estimates_frozen"):
        channels.of(row, group)[:] = 0.0
    channels.of(row, "phase")[:] = Phase.MOVING
    return row


def test_all_telemetry_groups_have_values_while_all_are_current(supervisor: Supervisor, row: Array) -> None:
    assert groups_with_values(supervisor, row) == VECTORS


def test_a_row_with_frozen_estimates_has_only_values_that_are_read(supervisor: Supervisor, row: Array) -> None:
    supervisor.channels.of(row, "estimates_frozen")[:] = 1.0
    assert groups_with_values(supervisor, row) == {"joints", "trouble"}


def test_the_start_of_a_contact_is_null_while_estimates_are_frozen(supervisor: Supervisor, row: Array) -> None:
    supervisor.channels.of(row, "contact_start")[:] = 12.5
    assert sample_out(supervisor, row, 0, None)["contact_start"] == 12.5
    supervisor.channels.of(row, "estimates_frozen")[:] = 1.0
    assert sample_out(supervisor, row, 0, None)["contact_start"] is None


@pytest.mark.parametrize(("place", "old"), [(1, BY_TRACKER), (2, BY_SENSORS)])
def test_the_telemetry_values_of_a_silent_device_are_null(
    supervisor: Supervisor, row: Array, place: int, old: set[str]
) -> None:
    troubles = supervisor.channels.of(row, "trouble")
    troubles[place] = Severity.WARN
    assert groups_with_values(supervisor, row) == VECTORS
    troubles[place] = Severity.HOLD
    assert groups_with_values(supervisor, row) == VECTORS - old


def test_ground_truth_is_null_where_it_is_unknown(supervisor: Supervisor, row: Array) -> None:
    supervisor.channels.of(row, "truth_known")[:] = 0.0
    assert groups_with_values(supervisor, row) == VECTORS - TRUE
    assert sample_out(supervisor, row, 0, None)["phase"] == "moving"


def test_tip_directions_are_null_where_the_direction_is_not_controlled(supervisor: Supervisor, row: Array) -> None:
    for group in DIRECTIONS:
        supervisor.channels.of(row, group)[:] = 0.0
    assert groups_with_values(supervisor, row) == VECTORS - DIRECTIONS
