"""What every test shares: robot, a short experiment, and the rule that a test leaves nothing running behind.

A thread, a child process or a listening port that outlives its test fails that test. What was there
before it (a server or a browser that a whole module shares, say) is not the test's, nor what that starts.
"""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from core.robot import Joint, Robot, Section, Tube
from station.cli import main
from station.config import PRESETS
from station.robots import RobotFile, load_robot


class FileByFile(LoadFileScheduling):
    """Tests over all processors, a file to each; those of real processes one after the other on one of them."""

    def _split_scope(self, nodeid: str) -> str:
        return "live" if nodeid.startswith("tests/live/") else super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FileByFile:
    return FileByFile(config, log)


#: One second at rest under no load, counted from the start.
SHORT = """
title = "short"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 1.0
settling = 0.0
[trajectory]
kind = "hold"
"""


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
    """Seconds in which what a test has stopped may still be going; a module may override it."""
    return 2.0


@pytest.fixture(autouse=True)
def nothing_is_left_behind(grace: float) -> Iterator[None]:
    """Fail a test that leaves a thread, a child process or a listening port."""
    shared = {child.pid for child in psutil.Process().children()}
    before = what_runs(shared)
    yield
    left = what_runs(shared) - before
    give_up = time.monotonic() + grace
    while left and time.monotonic() < give_up:
        time.sleep(0.02)
        left = what_runs(shared) - before
    if left:
        pytest.fail("left behind: " + ", ".join(sorted(f"{kind} {name}" for kind, _, name in left)), pytrace=False)


def what_runs(shared: set[int]) -> set[tuple[str, int, str]]:
    """Threads, child processes and ports open to others, each as kind, identity and name.

    Children in `shared` are left out with all that they have started.
    """
    found = {("thread", thread.ident or 0, thread.name) for thread in threading.enumerate()}
    # The interpreter's own tracker of shared memory stays until the interpreter ends.
    tracker = getattr(resource_tracker._resource_tracker, "_pid", None)
    myself = psutil.Process()
    mine = [child for child in myself.children() if child.pid not in shared and child.pid != tracker]
    for process in (myself, *mine, *(grandchild for child in mine for grandchild in descendants(child))):
        try:
            if process != myself:
                found.add(("process", process.pid, f"{process.pid} ({process.name()})"))
            for connection in process.net_connections():
                serves = connection.status == psutil.CONN_LISTEN
                receives = connection.type == socket.SOCK_DGRAM and connection.laddr and not connection.raddr
                if serves or receives:
                    found.add(("port", connection.laddr.port, str(connection.laddr.port)))
        except psutil.NoSuchProcess:
            continue  # ended while it was looked at
    return found


def descendants(process: psutil.Process) -> list[psutil.Process]:
    """Children of children; none when the process has just ended."""
    try:
        return process.children(recursive=True)
    except psutil.NoSuchProcess:
        return []
