"""Outcome of a run's recording, and the error for a recording that cannot be written or read."""

from enum import StrEnum

from core.errors import CtrError


class RunOutcome(StrEnum):
    """Outcome of a run's recording; the reason is stored separately as its `cause`."""

    COMPLETE = "complete"  #: the run ended as planned
    STOPPED = "stopped"  #: an operator, HOLD or a fault ended the run early
    INTERRUPTED = "interrupted"  #: the process that carried out or recorded the run ended early
    INCOMPLETE = "incomplete"  #: the disk was full, so the last rows are missing


class RecordingError(CtrError):
    """A recording cannot be written or read."""
