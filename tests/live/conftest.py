"""What the tests of real processes share: a station of a module, and the command line."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.serving import Served, serving


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that share the session's station in the middle: a station that nobody uses takes time from the others.

    Workers come from both ends.
    """
    files = list(dict.fromkeys(item.path for item in items))
    sharing = {item.path for item in items if _shares_the_station(item)}
    alone = [path for path in files if path not in sharing]
    half = len(alone) // 2
    order = [*alone[:half], *(path for path in files if path in sharing), *alone[half:]]
    items.sort(key=lambda item: order.index(item.path))


def _shares_the_station(item: pytest.Item) -> bool:
    found = item._fixtureinfo.name2fixturedefs.get("running", ())
    return bool(found) and found[-1].baseid == "tests/live"


@pytest.fixture(scope="session")
def running() -> Iterator[Served]:
    """The station that all share who leave it READY."""
    with serving() as served:
        yield served


@pytest.fixture
def station(running: Served) -> Served:
    """It, READY and without an operator."""
    running.ready()
    return running


@pytest.fixture
def environment() -> dict[str, str]:
    """Of a process that finds this project from any folder."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100"}


@pytest.fixture
def command_line(tmp_path: Path, environment: dict[str, str]) -> Callable[..., subprocess.CompletedProcess[bytes]]:
    """`python -m station` in a process and a folder of its own."""

    def run(*arguments: str, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
        command = [sys.executable, "-m", "station", *arguments]
        return subprocess.run(command, input=stdin, capture_output=True, cwd=tmp_path, env=environment, timeout=110)

    return run
