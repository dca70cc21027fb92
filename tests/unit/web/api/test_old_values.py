"""What nobody renews is told to nobody as a value of now: neither by the status nor by the stream of telemetry."""

from collections.abc import Iterator

import numpy as np
import pytest

from core.robot.robot import Array
from station.control.task import Phase
from station.devices.interfaces import Severity
from station.service.standing import DIRECTIONS, FELT, TRACKED, TRUE
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from web.api.bench import devices_out
from web.api.control import SCALARS, STREAMED, sample_out


@pytest.fixture(scope="module")
def service() -> Iterator[StationService]:
    supervisor = Supervisor(load_station(None).bench())
    yield StationService(supervisor)
    supervisor.close()


VECTORS = frozenset(STREAMED) - set(SCALARS)


def told(service: StationService, row: Array) -> frozenset[str]:
    """Groups that the stream has a value of; status and raw values agree."""
    supervisor = service.supervisor
    supervisor.ring.write(row)
    sample = sample_out(service, row, 0, None)
    fresh = frozenset(group for group in VECTORS if sample[group] is not None)
    assert VECTORS - supervisor.status().standing == fresh
    assert any(name.startswith("force.") for name in devices_out(service).raw) == ("force" in fresh)
    return fresh


@pytest.fixture
def row(service: StationService) -> Array:
    channels = service.supervisor.channels
    row = np.ones(len(channels))
    for group in ("trouble", "held"):
        channels.of(row, group)[:] = 0.0
    channels.of(row, "phase")[:] = Phase.MOVING
    return row


def test_all_of_a_row_is_told_while_all_of_it_is_renewed(service: StationService, row: Array) -> None:
    assert told(service, row) == VECTORS


def test_of_a_row_that_is_held_only_what_is_read_is_told(service: StationService, row: Array) -> None:
    service.supervisor.channels.of(row, "held")[:] = 1.0
    assert told(service, row) == {"joints", "trouble"}


@pytest.mark.parametrize(("place", "old"), [(1, TRACKED), (2, FELT)])
def test_a_silent_device_s_values_are_not_told(
    service: StationService, row: Array, place: int, old: frozenset[str]
) -> None:
    troubles = service.supervisor.channels.of(row, "trouble")
    troubles[place] = Severity.WARN
    assert told(service, row) == VECTORS
    troubles[place] = Severity.HOLD
    assert told(service, row) == VECTORS - old


def test_where_nothing_is_known_to_be_true_nothing_is_told(service: StationService, row: Array) -> None:
    service.supervisor.channels.of(row, "truth_known")[:] = 0.0
    assert told(service, row) == VECTORS - TRUE
    assert sample_out(service, row, 0, None)["phase"] == "moving"


def test_a_direction_that_nobody_asks_for_is_not_told(service: StationService, row: Array) -> None:
    for group in DIRECTIONS:
        service.supervisor.channels.of(row, group)[:] = 0.0
    assert told(service, row) == VECTORS - set(DIRECTIONS)
