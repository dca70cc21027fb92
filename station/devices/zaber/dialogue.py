"""What a Zaber chain is asked, one thing at a time, and what it tells: answers, and what happened by itself."""

from typing import NamedTuple


class Ask(NamedTuple):
    """One question or setting for one axis."""

    axis: int
    command: int
    data: int = 0
    reply: int | None = None  #: command number of the reply; None: none is waited for


class Answer(NamedTuple):
    """What came of an `Ask`."""

    data: int | None = None  #: None: no reply in time, or none was waited for
    error: int | None = None


class Lost(NamedTuple):
    """An axis does not answer any more."""

    axis: int


class ResetDone(NamedTuple):
    """An axis that would not stop homing was reset: it does not know where it is."""

    axis: int


class UnexpectedMotion(NamedTuple):
    """An axis moves as nobody told it to."""

    axis: int


class Complaint(NamedTuple):
    """An error reply that belongs to no question."""

    axis: int
    code: int


Happening = Answer | Lost | ResetDone | UnexpectedMotion | Complaint
