"""Fixtures of all live tests: a running station for each module, and the command line."""

import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from tests.harness.serving import Served, serving
from tests.harness.shared import Shared
from tests.harness.waiting import NET

HERE = Path(__file__).parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order the tests: browser tests first, then other live tests, then the rest; tests that share a station together.

    One worker then runs the browsers, whose drawing occupies a processor, and the shared stations end early.
    """
    pages = {item.path for item in items if "browser" in item.fixturenames}
    sharing = {item.path for item in items if _shares_the_station(item)}
    live = {item.path for item in items if item.path.is_relative_to(HERE)}
    faults = {item.path for item in items if "lone" in item.fixturenames}
    first = (live, pages, sharing, faults)
    items.sort(key=lambda item: (*(item.path not in paths for paths in first), "lone" not in item.fixturenames))
    config.stash[_SHARING] = sharing


_SHARED = pytest.StashKey[Shared[Served]]()
#: Files with tests that share the station.
_SHARING = pytest.StashKey[set[Path]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """End the shared station before a file that does not use it; the station occupies a quarter of a processor."""
    try:
        return (yield)
    finally:  # a failed teardown must leave no station behind
        if nextitem is None or nextitem.path not in item.config.stash.get(_SHARING, ()):
            _shared(item.session).end()


@pytest.fixture(scope="session", autouse=True)
def _ctrl_c_reaches_processes() -> None:
    """Restore Ctrl-C, which a shell's background job ignores, so that processes started by tests react to it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module")
def running(request: pytest.FixtureRequest) -> Served:
    return _shared(request.session)()


def _shares_the_station(item: pytest.Item) -> bool:
    found = item._fixtureinfo.name2fixturedefs.get("running", ())
    return bool(found) and found[-1].baseid == "tests/live"


def _shared(session: pytest.Session) -> Shared[Served]:
    return session.stash.setdefault(_SHARED, Shared(serving))


@pytest.fixture
def station(running: Served) -> Served:
    """Return the running station, READY and without an operator."""
    running.ready()
    return running


@pytest.fixture
def command_line(tmp_path: Path, environment: dict[str, str]) -> Callable[..., subprocess.CompletedProcess[bytes]]:
    """Return a function that runs `python -m station` in a separate process and folder."""

    def run(*arguments: str, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
        command = [sys.executable, "-m", "station", *arguments]
        return subprocess.run(command, input=stdin, capture_output=True, cwd=tmp_path, env=environment, timeout=NET)

    return run
