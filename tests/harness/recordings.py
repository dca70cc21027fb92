"""Fixtures with telemetry rows of a robot at rest, and with recordings of such rows."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.telemetry import Channels
from station.recording.run_outcome import RunOutcome
from station.recording.writer import CaseWriter

PERIOD = 0.002


@pytest.fixture(scope="session")
def channels(paper: RobotFile) -> Channels:
    return Channels(paper.robot())


@pytest.fixture(scope="session")
def make_rows(channels: Channels) -> Callable[..., Array]:
    """Return a function that makes random telemetry rows whose joints and forces the model can solve."""

    def make(count: int, first: int = 0) -> Array:
        rows = np.random.default_rng(first).normal(size=(count, len(channels)))
        rows[:, 0] = (first + np.arange(count)) * PERIOD
        channels.of(rows, "joints")[:] = (0.3, np.pi / 2, -0.1)
        channels.of(rows, "force_filtered")[:] = (0.2, 0.0, 0.1)
        channels.of(rows, "truth_known")[:] = 1.0
        return rows

    return make


@pytest.fixture
def open_writer(tmp_path: Path, paper: RobotFile, channels: Channels) -> Callable[..., CaseWriter]:
    """Return a function that opens a writer of `<name>.mcap` in the test's folder."""

    def open_(name: str = "one", **metadata: object) -> CaseWriter:
        return CaseWriter(tmp_path / f"{name}.mcap", paper.robot(), channels.all, metadata)

    return open_


@pytest.fixture
def recorded(open_writer: Callable[..., CaseWriter]) -> Callable[..., Path]:
    """Return a function that writes rows to a finished recording, in chunks of 100."""

    def record(rows: Array, name: str = "one", **metadata: object) -> Path:
        writer = open_writer(name, **metadata)
        for first in range(0, len(rows), 100):
            writer.write(rows[first : first + 100])
        writer.close(RunOutcome.COMPLETE)
        return writer.path

    return record
