"""The station's side of a procedure that thinks in a process of its own."""

import contextlib
import multiprocessing
from typing import Any

from core.errors import CtrError
from station.calibration.procedure import AbortedError, Answer, Step
from station.calibration.worker import Failed, Finished, Job, Said, run_worker


class FailedError(CtrError):
    """A procedure that came to no result; the text says why."""


class WorkerHost:
    """Owner of one such process."""

    def __init__(self, job: Job) -> None:
        """Start it; its first step takes a while."""
        context: Any = multiprocessing.get_context("spawn")
        self._pipe, child = context.Pipe()
        self._process = context.Process(target=run_worker, args=(job, child), name="guide", daemon=True)
        self._process.start()
        child.close()

    def heard(self, patience: float) -> Step | Finished | None:
        """The next step, or that the results are there; None when neither has come within `patience` [s].

        Raises:
            FailedError: there will be no result.
            AbortedError: the process has ended.
        """
        try:
            if not self._pipe.poll(patience):
                return None
            said: Said = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            status = self._process.exitcode
            raise AbortedError(f"the process that plans and computes has ended with status {status}") from None
        if isinstance(said, Failed):
            raise FailedError(said.reason)
        return said

    def answer(self, answer: Answer) -> None:
        """The step was carried out."""
        with contextlib.suppress(OSError):  # `heard` says that it is gone
            self._pipe.send(answer)

    def close(self) -> None:
        """End it, whatever it is doing."""
        self._process.terminate()
        self._process.join()
        self._process.close()
        self._pipe.close()
