"""What can go wrong, as types. Every message names the thing, the value, the bound and the unit."""

from typing import Self


class CtrError(Exception):
    """Base of every error this project raises on purpose; its text is one line for a person."""

    time: float | None = None  #: of a motion at which it goes wrong, where it is about one [s]

    def at(self, time: float) -> Self:
        """The same, with the time of the motion that it is about [s]."""
        self.time = time
        return self


class DescriptionError(CtrError):
    """A robot, trajectory or controller that cannot be, refused by the name of the wrong value."""


class PoseError(CtrError):
    """Joint positions at which this robot cannot stand."""


class NoSolution(CtrError):
    """The loaded model has no solution that the solver could reach; never returned as a wrong answer."""


class NotFinite(CtrError):
    """A NaN or an infinity where a number is required."""


class Unreachable(CtrError):
    """A motion that the robot cannot follow; the text says from when on and which limit is in the way."""
