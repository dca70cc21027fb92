"""A calibration as a conversation: it says what to do next, and is told what was measured.

A procedure is a generator. It yields steps, `GoTo` a pose and rest there, `Swing` the joints or `Ask` a
person for something, and is sent the `Measurement` of each pose and what was recorded of a swing. Who carries the
steps out, a loop in virtual time or a station with an operator, does not matter to it; to abort is to close it.
"""

from collections.abc import Generator
from typing import Generic, NamedTuple, TypeVar

from core.calibration.measurements import Measurement
from core.errors import CtrError
from core.robot.robot import Array

Result = TypeVar("Result")


class GoTo(NamedTuple):
    """Go to a pose, rest, measure; answered with a `Measurement`."""

    joints: Array  #: (n,) [rad or m]
    weight: float | None  #: known to hang at the tip meanwhile [N]
    done: float  #: part of the procedure that is done before it, 0 ... 1


class Ask(NamedTuple):
    """Something that a person does while the robot rests; answered with None when it is done."""

    text: str
    weight: float  #: that hangs at the tip from then on [N]
    done: float


class Swing(NamedTuple):
    """Move all joints to and fro from where they are; answered with `Swung`."""

    amplitudes: Array  #: (n,) [rad or m]
    period: float  #: [s]
    duration: float  #: [s]
    done: float


class Swung(NamedTuple):
    """What was recorded of a swing."""

    times: Array  #: (m,) [s]
    joints: Array  #: (m, n) as the stages count them [rad or m]
    frame_times: Array  #: (k,) when the frames were measured, as far as that is known [s]
    coils: Array  #: (k, 3) in the tracker's frame [m]


Step = GoTo | Ask | Swing
Answer = Measurement | Swung | None
Procedure = Generator[Step, Answer, Result]


class AbortedError(CtrError):
    """A procedure that was ended before it had a result."""


class StoppedByHandError(AbortedError):
    """Ctrl-C."""


class Guided(Generic[Result]):
    """A procedure under way."""

    def __init__(self, procedure: Procedure[Result]) -> None:
        """Begin; raises what the procedure raises while it plans."""
        self.step: Step | None = None  #: what is to be done now; None at the end
        self.result: Result | None = None  #: at the end
        self._procedure = procedure
        self._advance(None, first=True)

    @property
    def done(self) -> float:
        """Part that is done, 0 ... 1."""
        return 1.0 if self.step is None else self.step.done

    def answer(self, answer: Answer) -> None:
        """The step was carried out; raises what the procedure makes of it (`Unobservable` and others)."""
        self._advance(answer, first=False)

    def abort(self) -> None:
        """Give up; nothing is kept."""
        self._procedure.close()
        self.step = None

    def _advance(self, answer: Answer, first: bool) -> None:
        try:
            self.step = next(self._procedure) if first else self._procedure.send(answer)
        except StopIteration as end:
            self.step, self.result = None, end.value
