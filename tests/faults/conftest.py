"""What the tests of faults share: a bench in virtual time."""

from collections.abc import Callable
from pathlib import Path

import pytest

from station.experiments.experiment import Case
from station.robots import RobotFile, load_robot
from tests.faults.virtual import VirtualStation, usual_case


@pytest.fixture(scope="session")
def case() -> Case:
    return usual_case()


@pytest.fixture
def virtual(case: Case) -> VirtualStation:
    """Not READY yet."""
    return VirtualStation(case)


@pytest.fixture(scope="session")
def paper() -> RobotFile:
    return load_robot("paper")


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write a TOML file and say where it is."""

    def write(text: str) -> Path:
        path = tmp_path / "own.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write
