"""Fixtures of the fault tests: one live station that survives them, and a lab that records its stages' commands."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.watched_lab import WatchedLab
from tests.tools.kill_stations import back


@pytest.fixture(scope="package")
def watched_lab() -> Iterator[WatchedLab]:
    with WatchedLab(CLOCK) as lab:
        yield lab


@pytest.fixture(scope="package")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the station's recorded runs."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="package")
def lone(watched_lab: WatchedLab, recordings: Path) -> Iterator[LoneStation]:
    with lone_station(recordings, watched_lab) as station:
        yield station


@pytest.fixture
def mortal(lone: LoneStation) -> LoneStation:
    """Return the shared station in the state READY, for tests that kill or suspend one of its processes."""
    back(lone)
    return lone
