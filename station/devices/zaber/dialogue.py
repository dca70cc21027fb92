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

    data: int | None = None  #: data of the reply; None: no reply came in time, or none is expected
    error: int | None = None  #: error code; None: no error reply


class ReplyLost(NamedTuple):
    """Event: an axis no longer answers."""

    axis: int


class ResetDone(NamedTuple):
    """Event: the host has reset an axis that did not stop its homing; the position of the axis is unknown."""

    axis: int


class UnexpectedMotion(NamedTuple):
    """Event: an axis does not move as commanded."""

    axis: int


class UnsolicitedError(NamedTuple):
    """Event: an axis has sent an error reply that belongs to no request."""

    axis: int
    code: int


Happening = Reply | ReplyLost | ResetDone | UnexpectedMotion | UnsolicitedError
