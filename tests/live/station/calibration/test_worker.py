"""A worker process of a calibration that is stopped by a signal (SIGSTOP) is detected and ended."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from station.calibration.procedure import AbortedError
from station.calibration.worker import CalibrationJob, WorkerHost
from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import Ring
from station.control.telemetry import Channels
from station.lab.aurora_coil import GENERATOR_POSE


@pytest.fixture
def job(paper, tmp_path: Path) -> CalibrationJob:
    start = np.array([0.0, np.pi / 2.0, -0.1])
    folder = tmp_path / "found"
    return CalibrationJob(
        "tracker", 0.5, (0.5,), paper, start, GENERATOR_POSE, "a bench", None, True, "2026-01-01", folder, None, 0.0,
    )  # fmt: skip


@pytest.fixture
def ring(job) -> Iterator[Ring]:
    ring = Ring(len(Channels(job.robot.robot())))
    yield ring
    ring.close(remove=True)


def listen(worker: WorkerHost) -> None:
    """Receive messages of the worker until it raises an error."""
    while True:
        worker.receive(0.05)


def test_stopped_worker_ends_the_procedure_with_the_reason(job, ring):
    worker = WorkerHost(job, ring, REAL_TIME_CLOCK, stalled=1.0)
    try:
        os.kill(worker._child.pid, signal.SIGSTOP)
        with pytest.raises(AbortedError, match="has used no processor time for 1 s"):
            listen(worker)
    finally:
        os.kill(worker._child.pid, signal.SIGCONT)
        worker.close()


def test_stopped_worker_can_be_ended(job, ring):
    worker = WorkerHost(job, ring, REAL_TIME_CLOCK)
    os.kill(worker._child.pid, signal.SIGSTOP)
    worker.close()
    assert not worker._child.alive
