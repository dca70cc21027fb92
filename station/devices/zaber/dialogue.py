"""Requests to a Zaber chain, their replies, and the events that a chain reports."""

from typing import NamedTuple


class Request(NamedTuple):
    """One query or setting of one axis."""

    axis: int
    command: int
    data: int = 0
    reply: int | None = None  #: command number of the reply; None: no reply is expected


class Reply(NamedTuple):
    """Result of a `Request`."""

    data: int | None = None  #: None: no reply in time, or no reply is expected
    error: int | None = None


class ReplyLost(NamedTuple):
    """An axis no longer answers."""

    axis: int


class ResetDone(NamedTuple):
    """An axis that did not stop homing was reset: its position is unknown."""

    axis: int


class UnexpectedMotion(NamedTuple):
    """An axis does not move as commanded."""

    axis: int


class UnsolicitedError(NamedTuple):
    """An error reply without a request."""

    axis: int
    code: int


Happening = Reply | ReplyLost | ResetDone | UnexpectedMotion | UnsolicitedError
