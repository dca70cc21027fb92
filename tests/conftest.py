"""Fixtures of all tests: a robot, a short experiment, the command line, and the check for leftover processes."""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

from core.robot.robot import Joint, Robot, Section, Tube
from station.cli.main import main
from station.config.robots import RobotFile, load_robot
from station.config.strict import PRESETS
from station.threads import limit_to_one_thread
from tests.harness.cases import SHORT
from tests.harness.leftovers import nothing_left_behind
from tests.harness.root import ROOT

# The limit applies to pytest's workers and to all processes that tests start.
limit_to_one_thread()
# Processes that tests start write their compiled Python files to disk, so that later processes start faster.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Examples have no time limit, because another program may delay any of them. Every run has the same examples, so that
# no change is refused by chance; `--hypothesis-profile=random` has new ones (weekly, .github/workflows/thorough.yml).
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None)
settings.load_profile("same")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests so that those of devices and of the lab run last."""
    items.sort(key=lambda item: bool(re.match(r"tests/\w+/station/(devices|lab)/", item.nodeid)))


class FromBothEnds(LoadFileScheduling):
    """Scheduler of whole files: the last worker takes files from the end of the list, all others from its start.

    In a fresh clone one worker then compiles the model, and another worker compiles the lab.
    """

    def _assign_work_unit(self, node: WorkerController) -> None:
        if node is self.nodes[-1]:
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FromBothEnds:
    return FromBothEnds(config, log)


@pytest.fixture(scope="session")
def paper_robot() -> Robot:
    """Return the paper's robot: the two tubes of its Table I and three motors."""
    curved = Section(0.153, curvature=(4.0, 0.0))
    inner = Tube("inner", (Section(0.150), curved), 0.0413, 0.30, outer_diameter=2.0e-3, inner_diameter=1.2e-3)
    outer = Tube("outer", (Section(0.012), curved), 0.0480, 0.30, outer_diameter=2.45e-3, inner_diameter=2.1e-3)
    joints = (
        Joint("outer_rotation", 1, "rotation"),
        Joint("inner_rotation", 0, "rotation"),
        Joint("inner_translation", 0, "translation"),
    )
    return Robot("paper", (inner, outer), joints, integrator="paper")


@pytest.fixture(scope="session")
def paper() -> RobotFile:
    return load_robot("paper")


@pytest.fixture
def robot_text() -> str:
    """Return the text of the paper's robot file, which tests can change to make it invalid."""
    return (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")


@pytest.fixture
def short() -> str:
    """Return the text of a short experiment file, which tests can change."""
    return SHORT


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a TOML file and returns its path."""

    def write(text: str, name: str = "own") -> Path:
        path = tmp_path / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


class Done(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Done]:
    """Return a function that runs a command in this process; the working folder is the test's temporary folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: str) -> Done:
        try:
            status = main(arguments)
        except SystemExit as leaves:
            status = int(leaves.code or 0)
        return Done(status, *capsys.readouterr())

    return call


@pytest.fixture
def grace() -> float:
    """Return the time that threads and processes have to end after a test [s]; only a failing test uses all of it."""
    return 30.0


@pytest.fixture(autouse=True)
def nothing_is_left_behind(grace: float) -> Iterator[None]:
    """Check that no thread, child process or listening port outlives its test."""
    with nothing_left_behind(grace):
        yield


@pytest.fixture(scope="session")
def environment() -> dict[str, str]:
    """Return the environment variables with which a process finds this project from any folder."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100"}
