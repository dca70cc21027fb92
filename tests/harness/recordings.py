"""Fixtures with telemetry rows of a robot at rest, and with recordings of such rows."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.telemetry import Channel, Channels
from station.recording.run_outcome import RunOutcome
from station.recording.writer import CaseWriter

PERIOD = 0.002
#: Resolution of a recording for computed channels of each unit.
STEPS = {"m": 1 / 2**22, "rad": 1 / 2**22, "m/s": 1 / 2**18, "rad/s": 1 / 2**18, "N": 1 / 2**14, "N/s": 1 / 2**14}
STEPS["N m"] = 1 / 2**21
MEASURED = ("joints.", "wrench_raw.", "tip_measured.", "target_measured.", "direction_measured.")


def as_recorded(rows: Array, channels: Sequence[Channel]) -> Array:
    """Return the values that a recording of these rows must have, computed number by number."""

    def rounded(value: float, channel: Channel) -> float:
        unit = "rad" if channel.name.startswith("direction_") else channel.unit
        step = STEPS.get(unit) or 2.0 ** (math.floor(math.log2(abs(value))) + 1 - 11 if value else 0)
        return round(value / step) * step

    kept = np.empty(np.shape(rows))
    for column, channel in enumerate(channels):
        values = np.array(rows)[:, column]
        if channel.unit != "s" and not channel.name.startswith(MEASURED):
            values = np.array([rounded(value, channel) for value in values.tolist()])
        kept[:, column] = values if channel.unit == "s" else values.astype(np.float32)
    return kept


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
