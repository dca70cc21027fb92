"""One procedure on a running station, from its first step to its end; `run` belongs in a thread of its own."""

import contextlib
import shutil
import threading
import time
from enum import StrEnum
from typing import Any

import numpy as np
from pydantic import computed_field

from core.errors import CtrError
from core.robot.robot import Array
from station.calibration.catalogue import OFFERS
from station.calibration.procedure import AbortedError, Answer, Ask, GoTo, Step, Swung
from station.calibration.visiting import SWINGING, measured, still, task
from station.calibration.worker import Finished, Job
from station.calibration.worker_host import WorkerHost
from station.config.strict import Strict
from station.control.states import RefusedError, State
from station.control.task import Task
from station.lab.loads import ConstantLoad, NoLoad
from station.service.start import Start
from station.service.supervisor import Supervisor

#: Between two looks at the station [s].
LOOK = 0.05
#: In which a procedure goes on; any other ends it.
WELL = (State.READY, State.RUNNING)


class Stage(StrEnum):
    """What a procedure is doing."""

    THINKING = "thinking"  #: poses are being chosen, or numbers worked out
    MOVING = "moving"
    ASKING = "asking"  #: it waits for a person
    DONE = "done"
    ABORTED = "aborted"
    FAILED = "failed"  #: what was measured does not tell what was looked for


class Report(Strict):
    """The procedure that is on, or the last one: how it is getting on, or how it has ended."""

    what: str
    effort: float
    """so many times the usual number of poses"""
    stage: Stage
    done: float = 0.0
    """part of it, 0 ... 1"""
    says: str
    """what is going on, or why it has ended"""
    asked: str = ""
    """what a person is asked to do; empty when nothing"""
    hangs: float = 0.0
    """known to hang at the tip, or to be hung there now [N]"""
    elapsed: float = 0.0
    """[s]"""
    left: float = 0.0
    """as expected [s]"""
    result: str = ""
    """name of the folder with what was found; empty while there is nothing"""

    @computed_field
    @property
    def on(self) -> bool:
        """Whether it has not ended."""
        return self.stage in (Stage.THINKING, Stage.MOVING, Stage.ASKING)

    def now(self, **changes: Any) -> "Report":
        """With these changes."""
        return self.model_copy(update=changes)


class CalibrationSession:
    """A procedure under way. Other threads may look at `report`, say `done` and `abort`."""

    def __init__(self, supervisor: Supervisor, job: Job) -> None:
        self._supervisor, self._job, self._clock = supervisor, job, supervisor.bench.clock
        self._controller = supervisor.bench.controlled(supervisor.bench.controller)
        self._answered, self._abort = threading.Event(), ""
        self._began, self._ended = self._clock.now(), 0.0
        self._expected = OFFERS[job.what].expected(job.effort, len(job.weights))
        self._zero: float | None = None  # telemetry's time at the first measurement [s]
        self._hung = 0.0  # at the tip, on a person's word [N]
        self._visits, self._trouble = 0, self._troubles()
        self._now = Report(what=job.what, effort=job.effort, stage=Stage.THINKING, says="it begins")

    @property
    def report(self) -> Report:
        """How it is getting on."""
        now, elapsed = self._now, (self._ended or self._clock.now()) - self._began
        if not now.on:
            return now.now(elapsed=elapsed)
        # Not by the pace so far: it has persons' time in it.
        return now.now(elapsed=elapsed, left=self._expected * (1.0 - now.done))

    def done(self) -> None:
        """A person has done what was asked for.

        Raises:
            RefusedError: nothing is asked for.
        """
        if self._now.stage is not Stage.ASKING:
            raise RefusedError("no procedure asks for anything now")
        self._answered.set()

    def abort(self, cause: str) -> None:
        """End it at its next look; what moves is stopped, and nothing is kept.

        Raises:
            RefusedError: it has ended.
        """
        if not self._now.on:
            raise RefusedError("no procedure is on")
        self._abort = cause

    def run(self) -> None:
        """Carry it out to the end, whatever that is."""
        ending, why = Stage.FAILED, "the procedure has ended unasked"
        try:
            with contextlib.closing(WorkerHost(self._job)) as guide:
                said = self._heard(guide, "the first poses are being chosen")
                while not isinstance(said, Finished):
                    guide.answer(self._carried_out(said))
                    said = self._heard(guide, "what was measured is being worked out")
            self._show(Stage.MOVING, 1.0, "the results are there; going back to the start pose", self._job.folder.name)
            ending, why = Stage.DONE, ""
            with contextlib.suppress(AbortedError, RefusedError):  # the results stand all the same
                self._go_back()
        except (AbortedError, RefusedError) as error:
            ending, why = Stage.ABORTED, str(error)
        except CtrError as error:
            ending, why = Stage.FAILED, str(error)
        finally:
            self._finish(ending, why)

    def _finish(self, ending: Stage, why: str) -> None:
        if self._supervisor.status().state is State.RUNNING:
            self._supervisor.stop()
        if ending is not Stage.DONE:
            shutil.rmtree(self._job.folder, ignore_errors=True)
        if hangs := max(self._now.hangs, self._hung):
            self._supervisor.apply_load(NoLoad())  # in a virtual lab; from a real tip a person has to take it
            why = f"{why}; a weight of {hangs:g} N may hang at the tip: take it off"
        self._ended = self._clock.now()
        self._now = self._now.now(stage=ending, says=why, asked="", hangs=0.0, left=0.0)

    # Steps

    def _heard(self, guide: WorkerHost, says: str) -> Step | Finished:
        """What comes next."""
        self._show(Stage.THINKING, self._now.done, says)
        while (said := guide.heard(LOOK)) is None:
            self._look()
        return said

    def _carried_out(self, step: Step) -> Answer:
        if isinstance(step, Ask):
            self._ask(step)
            return None
        self._visits += 1
        says = f"pose {self._visits}" if isinstance(step, GoTo) else "all joints swing to and fro"
        self._show(Stage.MOVING, step.done, says)
        before = self._joints()
        rows = self._rows(task(step, self._controller), f"calibrate {self._job.what}, {says}")
        answer = measured(self._supervisor.channels, rows, step, before, self._controller)
        if isinstance(answer, Swung):
            return answer
        # Counted from the first measurement: sensors drift by the hour, not by what the station's clock happens to say.
        self._zero = answer.time if self._zero is None else self._zero
        return answer._replace(time=answer.time - self._zero)

    def _ask(self, step: Ask) -> None:
        self._answered.clear()
        self._now = self._now.now(
            stage=Stage.ASKING, done=step.done, says="waiting for a person", asked=step.text, hangs=step.weight
        )
        while not self._answered.wait(LOOK):
            self._look()
        self._hung = step.weight
        # The virtual lab's part of a person's work; at a real bench nothing happens here.
        self._supervisor.apply_load(ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad())
        self._show(Stage.MOVING, step.done, "the weight comes to rest")
        end = self._clock.now() + SWINGING
        while self._clock.now() < end:
            self._look()
            time.sleep(LOOK)

    def _rows(self, what: Task, title: str) -> Array:
        """Telemetry (m, channels) of a task, carried out to its end."""
        self._look()
        ring = self._supervisor.ring
        kept, since = list[Array](), ring.written
        self._supervisor.start_step(Start(what, title, load=None, recorded=False))
        while True:
            time.sleep(LOOK)
            running = self._look() is State.RUNNING  # before the rows are read: then the last of them are there
            rows, since, _ = ring.read(since)
            kept.append(rows)
            if not running:
                return np.concatenate(kept)

    def _go_back(self) -> None:
        """To where it began."""
        start = self._job.start
        self._rows(Task(self._controller, still(start.size), 0.0, start), f"calibrate {self._job.what}, going back")

    # Looks

    def _show(self, stage: Stage, done: float, says: str, result: str = "") -> None:
        self._now = self._now.now(stage=stage, done=done, says=says, asked="", result=result)

    def _look(self) -> State:
        """The station's state.

        Raises:
            AbortedError: it is none in which a procedure goes on, or was so meanwhile, or a person has had enough.
        """
        if self._abort:
            raise AbortedError(self._abort)
        stopped = self._troubles() != self._trouble  # counted first: then a stop that is still on is told by its cause
        status = self._supervisor.status()
        if status.state not in WELL:
            raise AbortedError(f"the station is {status.state.name}: {status.cause or 'the cause is in the log'}")
        if stopped:
            raise AbortedError("the station was stopped meanwhile; the cause is in the log")
        return status.state

    def _troubles(self) -> int:
        """How often the station was stopped so far."""
        return sum(self._supervisor.entered(state) for state in State if state not in WELL)

    def _joints(self) -> Array:
        return self._supervisor.status().values["joints"]
