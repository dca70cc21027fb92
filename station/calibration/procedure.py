"""A calibration procedure as a generator: it yields steps and receives measurements.

The steps are `GoToPose` (move to a pose and rest), `SwingMotion` (oscillate the joints) and `OperatorPrompt` (a task
for the operator). The procedure receives the `Measurement` of each pose and the `SwingRecord` of each swing. A loop in
virtual time or a station with an operator executes the steps. Closing the generator aborts the procedure.
"""

from collections.abc import Generator
from typing import Generic, NamedTuple, TypeVar

from core.calibration.measurements import Measurement
from core.errors import CtrError
from core.robot.robot import Array

Result = TypeVar("Result")


class GoToPose(NamedTuple):
    """Step that moves the robot to a pose, rests and measures; its answer is a `Measurement`."""

    joints: Array  #: (n,) joint positions of the pose [rad or m]
    weight: float | None  #: known weight at the tip [N]; None if unknown
    done: float  #: share of the procedure that is done before this step, 0 ... 1


class OperatorPrompt(NamedTuple):
    """Step that prompts the operator for a task while the robot rests; its answer, after the task is done, is None."""

    text: str
    weight: float  #: weight at the tip after the task [N]
    done: float


class SwingMotion(NamedTuple):
    """Step that oscillates all joints from their present positions; its answer is a `SwingRecord`."""

    amplitudes: Array  #: (n,) peak-to-peak displacement of each joint, to one side of its start [rad or m]
    period: float  #: period of the oscillation [s]
    duration: float  #: duration of the oscillation [s]
    done: float


class SwingRecord(NamedTuple):
    """Recording of stages and tracker during a swing."""

    times: Array  #: (m,) times of the joint positions [s]
    joints: Array  #: (m, n) joint positions that the stages reported [rad or m]
    frame_times: Array  #: (k,) measurement times of the tracker's frames, computed with the known latency [s]
    coils: Array  #: (k, 3) positions of the coil in the tracker's frame [m]


Step = GoToPose | OperatorPrompt | SwingMotion
Answer = Measurement | SwingRecord | None
Procedure = Generator[Step, Answer, Result]


class AbortedError(CtrError):
    """Error of a procedure that ended without a result."""


class StoppedByHandError(AbortedError):
    """Error of a procedure that the operator ended by Ctrl-C."""


class GuidedProcedure(Generic[Result]):
    """A running procedure with its current step."""

    def __init__(self, procedure: Procedure[Result]) -> None:
        """Start the procedure; raises the errors of its planning."""
        self.step: Step | None = None  #: step to execute now; None at the end
        self.result: Result | None = None  #: result of the procedure at its end; None before
        self._procedure = procedure
        self._advance(None, first=True)

    @property
    def done(self) -> float:
        """Share of the procedure that is done, 0 ... 1."""
        return 1.0 if self.step is None else self.step.done

    def answer(self, answer: Answer) -> None:
        """Pass the answer to the current step; raises the procedure's errors (`Unobservable` and others)."""
        self._advance(answer, first=False)

    def abort(self) -> None:
        """Abort the procedure and discard its measurements."""
        self._procedure.close()
        self.step = None

    def _advance(self, answer: Answer, first: bool) -> None:
        try:
            self.step = next(self._procedure) if first else self._procedure.send(answer)
        except StopIteration as end:
            self.step, self.result = None, end.value
