"""What every test shares: the paper's robot, and the rule that a test leaves nothing running behind.

A thread, a child process or a listening port that outlives its test fails that test. What was there
before it (a server or a browser that a whole module shares, say) is not the test's, nor what that starts.
"""

import socket
import threading
import time
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path

import psutil
import pytest

from core.robot import Joint, Robot, Section, Tube
from tests.serving import Served, serving

#: Real processes, real browsers and real time: on a busy computer they get a second try.
REAL = (
    *(f"browser/test_{name}.py" for name in (
        "calibrate", "cut", "header", "keyboard", "page", "people", "pictures", "tabs",
    )),
    *(f"web/test_{name}.py" for name in ("access", "api", "calibration_api", "kills", "operator", "scene", "serve")),
    "station/commands/test_soak.py", "station/test_client.py", "station/test_own_bench.py",
    "station/calibration/test_live.py",
    *(f"faults/test_{name}.py" for name in (
        "bad_request", "browser_closed", "control_killed", "cross_site", "disk_full", "overrun",
        "station_killed", "two_operators",
    )),
)  # fmt: skip

#: Long ones, left out unless they are asked for: `pytest -m slow`, or `-m ""` for all.
SLOW = (
    "browser/test_tabs.py", "browser/test_pictures.py", "browser/test_calibrate.py", "station/commands/test_soak.py",
    "web/test_kills.py",
)  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what depends on the computer's time, and what takes minutes of it."""
    here = Path(__file__).parent
    for item in items:
        if any(item.path.is_relative_to(here / name) for name in SLOW):
            item.add_marker(pytest.mark.slow)
        if any(item.path.is_relative_to(here / name) for name in REAL):
            item.add_marker(pytest.mark.real)
        if item.get_closest_marker("real") or item.path.parent == here / "browser":
            item.add_marker(pytest.mark.flaky(reruns=2))


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


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    """A station that a module shares."""
    with serving() as served:
        yield served


@pytest.fixture
def station(running: Served) -> Served:
    """It, READY and without an operator."""
    running.ready()
    return running


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
