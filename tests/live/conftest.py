"""What the tests of real processes share: a station of a module, and the command line."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.serving import Served, serving


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
