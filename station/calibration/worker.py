"""The worker process of a calibration: it plans, fits and writes the results, while the station moves the robot.

Planning and fits take seconds of processor time. In the station process they would delay the page and STOP.
"""

import contextlib
import os
import time
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
from station.control.child_process import ChildProcess
from station.control.clock import StationClock
from station.control.guard import Rank, watching
from station.control.realtime import processor_time, set_process_name
from station.control.ring import Ring
from station.control.telemetry import Channels
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
    latency: float  #: latency of the tracker in that calibration [s]
    senses: bool = True  #: whether the bench has force sensors
    described: RobotFile | None = None  #: the robot's file, if `robot` has the tubes of an earlier calibration


class JobFinished(NamedTuple):
    """Message of the worker: the results are in the job's folder."""


class JobFailed(NamedTuple):
    """Message of the worker: there are no results; `reason` explains why."""

    reason: str


WorkerMessage = Step | JobFinished | JobFailed


def run_worker(job: CalibrationJob, ring_name: str, clock: StationClock, pipe: Connection, parent: int) -> None:
    """Run the worker process: send steps through `pipe` and receive an answer to each."""
    set_process_name("ctr-calibrate")
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    with (
        watching(ring_name, len(Channels(job.robot.robot())), Rank.CALIBRATION, clock, parent),
        contextlib.suppress(EOFError, OSError),  # the station process has closed the pipe
    ):
        try:
            _run_procedure(job, pipe)
        except CtrError as error:
            pipe.send(JobFailed(str(error)))


def _run_procedure(job: CalibrationJob, pipe: Connection) -> None:
    subject = PlanSubject.of(job.robot, job.start, senses=job.senses, described=job.described)
    guided, time = GuidedProcedure(start_procedure(job.what, subject, job.effort, job.weights)), 0.0
    while guided.step is not None:
        pipe.send(guided.step)
        answer: Answer = pipe.recv()
        if answer is not None:
            time = float(answer.times[-1]) if isinstance(answer, SwingRecord) else answer.time
        guided.answer(answer)
    result = guided.outcome()
    provenance = Provenance(job.what, job.when, job.bench, job.seed, time, job.simulated)
    write_all(job.folder, result, subject, provenance, job.assumed, job.known, job.latency)
    pipe.send(JobFinished())


#: Time without processor use after which a computing worker counts as stalled [s]. A signal or a lack of memory can
#: stall it.
STALLED_S = 30.0


class FailedError(CtrError):
    """Error of a procedure that has no result; the text has the reason."""


class WorkerHost:
    """Owner of one worker process."""

    def __init__(self, job: CalibrationJob, ring: Ring, clock: StationClock, stalled: float = STALLED_S) -> None:
        """Start the worker, which takes a while to send its first step.

        `stalled`: time without processor use after which the worker counts as stalled [s].
        """
        self._child = ChildProcess(run_worker, job, ring.name, clock, name="calibration")
        self._stalled, self._used, self._since = stalled, -1.0, time.monotonic()

    def receive(self, timeout: float) -> Step | JobFinished | None:
        """Return the next step, or `JobFinished`; None if neither arrives within `timeout` [s].

        Raises:
            FailedError: the procedure has failed and has no result.
            AbortedError: the process has ended or is stalled.
        """
        try:
            if not self._child.pipe.poll(timeout):
                self._check_progress()
                return None
            message: WorkerMessage = self._child.pipe.recv()
        except (EOFError, OSError):
            raise AbortedError(f"the process that plans and computes has ended {self._child.ended()}") from None
        if isinstance(message, JobFailed):
            raise FailedError(message.reason)
        return message

    def answer(self, answer: Answer) -> None:
        """Send the answer to the current step."""
        self._since = time.monotonic()  # count the time from now, because the worker had nothing to compute before
        self._child.send(answer)  # if the process has ended, `receive` reports it

    def close(self) -> None:
        """Kill the process; SIGTERM would not end a process that is stopped by a signal."""
        self._child.kill()
        self._child.ended()
        self._child.pipe.close()

    def _check_progress(self) -> None:
        """Raise AbortedError when the worker process has used no processor time for longer than `stalled`."""
        used, now = processor_time(self._child.pid), time.monotonic()
        if used is None or used != self._used:
            self._used, self._since = used or 0.0, now
        elif now - self._since > self._stalled:
            raise AbortedError(
                f"the process that plans and computes (pid {self._child.pid}) has used no processor time for"
                f" {self._stalled:g} s: it is stopped, or memory is short; start the procedure again"
            )
