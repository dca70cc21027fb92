"""What the tests of faults share: a bench in virtual time."""

import pytest

from station.experiments.experiment import Case
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture(scope="session")
def case() -> Case:
    return usual_case()


@pytest.fixture
def virtual(case: Case) -> VirtualStation:
    """Not READY yet."""
    return VirtualStation(case)
