"""Fixtures of the fault tests in virtual time: one case, and a station that runs it."""

import pytest

from station.experiments.experiment import Case
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture(scope="session")
def case() -> Case:
    return usual_case()


@pytest.fixture
def virtual(case: Case) -> VirtualStation:
    """Return a station in virtual time that is not READY yet."""
    return VirtualStation(case)
