"""One station for all faults that it outlives, on a lab that notes what its stages are told."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.harness.calm import CLOCK
from tests.harness.kill_stations import back
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.watched_lab import WatchedLab


@pytest.fixture(scope="package")
def watched_lab() -> Iterator[WatchedLab]:
    with WatchedLab(CLOCK) as lab:
        yield lab


@pytest.fixture(scope="package")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where that station's runs are."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="package")
def lone(watched_lab: WatchedLab, recordings: Path) -> Iterator[LoneStation]:
    with lone_station(recordings, watched_lab) as station:
        yield station


@pytest.fixture
def mortal(lone: LoneStation) -> LoneStation:
    """It, READY."""
    back(lone)
    return lone
