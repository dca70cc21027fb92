"""Fixtures of the fault tests: one live station that survives them, and a lab that records its stages' commands."""

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.shared import Shared
from tests.harness.watched_lab import WatchedLab
from tests.tools.kill_stations import back


class FaultRig(NamedTuple):
    """The station of the fault tests, its lab, and the folder of its recorded runs."""

    station: LoneStation
    lab: WatchedLab
    recordings: Path


@contextmanager
def fault_rig(new_folder: Callable[[str], Path]) -> Iterator[FaultRig]:
    """Yield a station on a watched lab; `new_folder` creates the folder of its recordings."""
    recordings = new_folder("runs")
    with WatchedLab(CLOCK) as lab, lone_station(recordings, lab) as station:
        yield FaultRig(station, lab, recordings)


_RIG = pytest.StashKey[Shared[FaultRig]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """End the shared station before a test that does not use it."""
    yield
    if _RIG in item.session.stash and "lone" not in getattr(nextitem, "fixturenames", ()):
        item.session.stash[_RIG].end()


@pytest.fixture(scope="module")
def rig(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> FaultRig:
    made = partial(fault_rig, tmp_path_factory.mktemp)
    return request.session.stash.setdefault(_RIG, Shared(made))()


@pytest.fixture(scope="module")
def watched_lab(rig: FaultRig) -> WatchedLab:
    return rig.lab


@pytest.fixture(scope="module")
def recordings(rig: FaultRig) -> Path:
    """Return the folder of the station's recorded runs."""
    return rig.recordings


@pytest.fixture(scope="module")
def lone(rig: FaultRig) -> LoneStation:
    return rig.station


@pytest.fixture
def mortal(lone: LoneStation) -> LoneStation:
    """Return the shared station in the state READY, for tests that kill or suspend one of its processes."""
    back(lone)
    return lone
