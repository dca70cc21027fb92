"""What the tests of faults share: a bench in virtual time, and a real station."""

from collections.abc import Iterator

import pytest

from station.experiments.experiment import Case
from tests.faults.virtual import VirtualStation, usual_case
from tests.serving import Served, serving


@pytest.fixture(scope="session")
def case() -> Case:
    return usual_case()


@pytest.fixture
def virtual(case: Case) -> VirtualStation:
    """Not READY yet."""
    return VirtualStation(case)


@pytest.fixture(scope="package")
def running() -> Iterator[Served]:
    with serving() as served:
        yield served


@pytest.fixture
def station(running: Served) -> Served:
    running.ready()
    return running
