"""What the tests of the station share: the paper's robot, short experiments, the command line."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from station.config import PRESETS
from station.robots import RobotFile, load_robot

ROOT = Path(__file__).parents[2]

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
