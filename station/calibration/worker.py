"""The worker process of a calibration: it plans, fits and writes the results, while the station moves the robot.

Planning and fits take seconds of processor time. In the station process they would delay the page and STOP.
"""

import contextlib
import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from core.errors import CtrError
from core.robot.robot import Array
from station.calibration.catalogue import start_procedure
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import PlanSubject
from station.calibration.procedure import AbortedError, Answer, GuidedProcedure, Step, SwingRecord
from station.config.robots import RobotFile
from station.control.realtime import set_process_name
from station.devices.aurora.tracker import TrackerMounting

#: Niceness of the worker process, which gives it a lower priority than all processes with deadlines.
NICENESS = 5


class CalibrationJob(NamedTuple):
    """A procedure to run, and the folder for its results."""

    what: str  #: name of the procedure in the catalogue
    effort: float
    weights: tuple[float, ...]  #: known weights that the operator hangs at the tip [N]
    robot: RobotFile  #: robot with its assumed parameters
    start: Array  #: (n,) rest position before and after the procedure [rad or m]
    assumed: TrackerMounting  #: assumed pose of the tracker
    bench: str  #: human-readable name of the bench
    seed: int | None  #: seed of the station's virtual lab; None: other devices
    simulated: bool  #: whether the devices report that they are simulated
    when: str  #: date and time, ISO 8601
    folder: Path  #: folder for the results, which is created with the first file
    known: Path | None  #: folder of the calibration in use; missing files are copied from it


class JobFinished(NamedTuple):
    """Message of the worker: the results are in the job's folder."""


class JobFailed(NamedTuple):
    """Message of the worker: there are no results; `reason` explains why."""

    reason: str


WorkerMessage = Step | JobFinished | JobFailed


def run_worker(job: CalibrationJob, pipe: Connection, _parent: int) -> None:
    """Main function of the process: it sends steps through `pipe` and receives an answer to each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the station process decides when the worker ends
    set_process_name("ctr-calibrate")
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    with contextlib.suppress(EOFError, OSError):  # the station process has closed the pipe
        try:
            _run_procedure(job, pipe)
        except CtrError as error:
            pipe.send(JobFailed(str(error)))


def _run_procedure(job: CalibrationJob, pipe: Connection) -> None:
    subject = PlanSubject.of(job.robot, job.start)
    guided, time = GuidedProcedure(start_procedure(job.what, subject, job.effort, job.weights)), 0.0
    while guided.step is not None:
        pipe.send(guided.step)
        answer: Answer = pipe.recv()
        if answer is not None:
            time = float(answer.times[-1]) if isinstance(answer, SwingRecord) else answer.time
        guided.answer(answer)
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    provenance = Provenance(job.what, job.when, job.bench, job.seed, time, job.simulated)
    write_all(job.folder, guided.result, subject, provenance, job.assumed, job.known)
    pipe.send(JobFinished())
