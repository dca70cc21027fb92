"""Exception types of the project. Every error message names the subject, the value, the bound and the unit."""

from typing import Self


class CtrError(Exception):
    """Base of every error that this project raises intentionally; its text is one human-readable line."""

    time: float | None = None  #: time in the motion at which the error occurs [s]; None: the error concerns no motion

    def at(self, time: float) -> Self:
        """Return this error after setting the time [s] of the motion at which it occurs."""
        self.time = time
        return self


class DescriptionError(CtrError):
    """The description of a robot, trajectory or controller is invalid; the text names the wrong value."""


class PoseError(CtrError):
    """The joint positions are invalid for this robot."""


class NoSolution(CtrError):
    """The solver found no shape of the robot under this load; the solver never returns a wrong shape instead."""


class NotFinite(CtrError):
    """A value is NaN or infinite where a finite number is required."""


class ContractError(CtrError):
    """Custom code (a loop, limit, load or driver) raised an error or returned a value that violates its interface."""


class Cancelled(Exception):
    """A computation was cancelled because its result is no longer required."""


class Unreachable(CtrError):
    """The robot cannot follow a motion; the text states the time and the limit that prevents it."""
