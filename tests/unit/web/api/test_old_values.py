"""What nobody renews is told to nobody as a value of now: neither by the status nor by the stream of telemetry."""

from collections.abc import Iterator

import numpy as np
import pytest

from core.robot.robot import Array
from station.control.ring import HELD, PHASE
from station.control.task import Phase
from station.devices.interfaces import Severity
from station.service.standing import COMPUTED, FELT, TRACKED
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from web.api.bench import devices_out
from web.api.control import STREAMED, sample_out


@pytest.fixture(scope="module")
def service() -> Iterator[StationService]:
    supervisor = Supervisor(load_station(None).bench())
    yield StationService(supervisor)
    supervisor.close()


def told(service: StationService, row: Array, held: bool) -> set[str]:
    """Groups that the stream has a value of, and status and raw values agree."""
    supervisor = service.supervisor
    supervisor.ring.counters[HELD] = held
    supervisor.ring.write(row)
    sample = sample_out(service, row, 0, None)
    fresh = {group for group in STREAMED if sample[group] is not None}
    assert {group for group in STREAMED if group not in supervisor.status().standing} == fresh
    assert any(name.startswith("force.") for name in devices_out(service).raw) == ("force" in fresh)
    return fresh


@pytest.fixture
def row(service: StationService) -> Array:
    channels = service.supervisor.channels
    row = np.ones(len(channels))
    channels.of(row, "trouble")[:] = 0.0
    return row


def test_all_of_a_row_is_told_while_all_of_it_is_renewed(service: StationService, row: Array) -> None:
    assert told(service, row, held=False) == set(STREAMED)


def test_of_a_row_that_is_held_only_what_is_read_is_told(service: StationService, row: Array) -> None:
    assert told(service, row, held=True) == set(STREAMED) - COMPUTED
    assert {"time", "state", "joints"} <= set(STREAMED) - COMPUTED


@pytest.mark.parametrize(("place", "old"), [(1, TRACKED), (2, FELT)])
def test_a_silent_device_s_values_are_not_told(
    service: StationService, row: Array, place: int, old: frozenset[str]
) -> None:
    troubles = service.supervisor.channels.of(row, "trouble")
    troubles[place] = Severity.WARN
    assert told(service, row, held=False) == set(STREAMED)
    troubles[place] = Severity.HOLD
    assert told(service, row, held=False) == set(STREAMED) - old


def test_the_stream_has_the_phase_of_its_row_and_no_truth_where_nothing_is_known(
    service: StationService, row: Array
) -> None:
    service.supervisor.ring.counters[PHASE], service.supervisor.ring.counters[HELD] = Phase.MOVING, 0
    service.supervisor.channels.of(row, "truth_known")[:] = 0.0
    sample = sample_out(service, row, 0, None)

    assert sample["phase"] == "moving"
    assert sample["tip_true"] is None
