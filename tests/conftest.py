"""What every test shares: robot, a short experiment, the command line, and that it leaves nothing behind."""

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
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

# Of workers and of all processes that tests start.
limit_to_one_thread()
# Processes that tests start keep what Python has compiled of this project, for those that come after them.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The mathematics first, what needs none of it last."""
    items.sort(key=lambda item: bool(re.match(r"tests/\w+/station/(devices|lab)/", item.nodeid)))


class FromBothEnds(LoadFileScheduling):
    """A file to each worker: the last one takes them from the last file back, the others from the first one on.

    So in a fresh clone the model is compiled by one, and the lab by another.
    """

    def _assign_work_unit(self, node: WorkerController) -> None:
        if node is self.nodes[-1]:
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FromBothEnds:
    return FromBothEnds(config, log)


@pytest.fixture(scope="session")
def paper_robot() -> Robot:
    """The two tubes of the paper's Table I and their three motors."""
    curved = Section(0.153, curvature=(4.0, 0.0))
    inner = Tube("inner", (Section(0.150), curved), 0.0413, 0.30, outer_diameter=2.0e-3, inner_diameter=1.2e-3)
    outer = Tube("outer", (Section(0.012), curved), 0.0480, 0.30, outer_diameter=2.45e-3, inner_diameter=2.1e-3)
    joints = (
        Joint("outer_rotation", 1, "rotation"),
        Joint("inner_rotation", 0, "rotation"),
        Joint("inner_translation", 0, "translation"),
    )
    return Robot("paper", (inner, outer), joints)


@pytest.fixture(scope="session")
def paper() -> RobotFile:
    return load_robot("paper")


@pytest.fixture
def robot_text() -> str:
    """The paper's robot as a file, to be spoilt."""
    return (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")


@pytest.fixture
def short() -> str:
    """A short experiment's file, to be changed."""
    return SHORT


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a TOML file and say where it is."""

    def write(text: str, name: str = "own") -> Path:
        path = tmp_path / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


class Done(NamedTuple):
    """What a command has left."""

    status: int
    out: str
    err: str


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Done]:
    """The command line in this process, in a folder of its own."""
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
    """Seconds in which what a test has stopped may still be going; only a test that fails takes them."""
    return 30.0


@pytest.fixture(autouse=True)
def nothing_is_left_behind(grace: float) -> Iterator[None]:
    """No thread, child process or listening port outlives its test."""
    with nothing_left_behind(grace):
        yield
