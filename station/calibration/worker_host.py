"""The station's side of a procedure that thinks in a process of its own."""

from core.errors import CtrError
from station.calibration.procedure import AbortedError, Answer, Step
from station.calibration.worker import Failed, Finished, Job, Said, run_worker
from station.control.child import Child


class FailedError(CtrError):
    """A procedure that came to no result; the text says why."""


class WorkerHost:
    """Owner of one such process."""

    def __init__(self, job: Job) -> None:
        """Start it; its first step takes a while."""
        self._child = Child(run_worker, job, name="calibration")

    def heard(self, patience: float) -> Step | Finished | None:
        """The next step, or that the results are there; None when neither has come within `patience` [s].

        Raises:
            FailedError: there will be no result.
            AbortedError: the process has ended.
        """
        try:
            if not self._child.pipe.poll(patience):
                return None
            said: Said = self._child.pipe.recv()
        except (EOFError, OSError):
            raise AbortedError(f"the process that plans and computes has ended {self._child.ended()}") from None
        if isinstance(said, Failed):
            raise FailedError(said.reason)
        return said

    def answer(self, answer: Answer) -> None:
        """The step was carried out."""
        self._child.tell(answer)  # `heard` says when it is gone

    def close(self) -> None:
        """End it, whatever it is doing."""
        self._child.terminate()
        self._child.ended()
        self._child.pipe.close()
