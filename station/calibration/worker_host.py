"""The station's side of a calibration's worker process: starts it, exchanges messages with it and ends it."""

import time

from core.errors import CtrError
from station.calibration.procedure import AbortedError, Answer, Step
from station.calibration.worker import CalibrationJob, JobFailed, JobFinished, WorkerMessage, run_worker
from station.control.child_process import ChildProcess
from station.control.realtime import processor_time

#: Time without processor use after which a computing worker counts as stalled [s]. A signal or a lack of memory can
#: stall it.
STALLED_S = 30.0


class FailedError(CtrError):
    """Error of a procedure that has no result; the text has the reason."""


class WorkerHost:
    """Owner of one worker process."""

    def __init__(self, job: CalibrationJob, stalled: float = STALLED_S) -> None:
        """Start the worker, which takes a while to send its first step.

        `stalled`: time without processor use after which the worker counts as stalled [s].
        """
        self._child = ChildProcess(run_worker, job, name="calibration")
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
