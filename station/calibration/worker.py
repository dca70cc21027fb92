"""A procedure in a process of its own: it plans, fits and writes; what moves is the station's.

Planning and fits take a processor for seconds: in the station's own process the page, and STOP, would wait for them.
"""

import contextlib
import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from core.errors import CtrError
from core.robot.robot import Array
from station.calibration.catalogue import begin
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import Subject
from station.calibration.procedure import AbortedError, Answer, Guided, Step, Swung
from station.config.robots import RobotFile
from station.control.realtime import show_as
from station.devices.aurora.tracker import Registration

#: Behind everything that has to be punctual.
NICENESS = 5


class Job(NamedTuple):
    """What is to be found out, and where the results go."""

    what: str  #: name in the catalogue
    effort: float
    weights: tuple[float, ...]  #: [N]
    robot: RobotFile  #: as it is believed to be
    start: Array  #: (n,) where it rests before and after [rad or m]
    assumed: Registration  #: where the tracker is believed to stand
    bench: str  #: for a person
    seed: int | None  #: of the virtual lab; None: devices that are real
    when: str  #: ISO 8601
    folder: Path  #: for the results; made when there are some
    known: Path | None  #: folder of the calibration in use: what is not found anew is taken from there


class Finished(NamedTuple):
    """The results are in the job's folder."""


class Failed(NamedTuple):
    """There are none, and why."""

    reason: str


Said = Step | Finished | Failed


def run_worker(job: Job, pipe: Connection, _parent: int) -> None:
    """Main function of the process: steps go out through `pipe`, an answer to each comes back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the station process decides when it ends
    show_as("ctr-calibrate")
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    with contextlib.suppress(EOFError, OSError):  # nobody is there any more
        try:
            _guide(job, pipe)
        except CtrError as error:
            pipe.send(Failed(str(error)))


def _guide(job: Job, pipe: Connection) -> None:
    subject = Subject.of(job.robot, job.start)
    guided, time = Guided(begin(job.what, subject, job.effort, job.weights)), 0.0
    while guided.step is not None:
        pipe.send(guided.step)
        answer: Answer = pipe.recv()
        if answer is not None:
            time = float(answer.times[-1]) if isinstance(answer, Swung) else answer.time
        guided.answer(answer)
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    provenance = Provenance(job.what, job.when, job.bench, job.seed, time)
    write_all(job.folder, guided.result, subject, provenance, job.assumed, job.known)
    pipe.send(Finished())
