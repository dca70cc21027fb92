"""How a recording ended, and what can be wrong with one."""

from enum import StrEnum

from core.errors import CtrError


class Label(StrEnum):
    """The last word about a recording; `cause` beside it says why."""

    COMPLETE = "complete"  #: the run came to its end
    STOPPED = "stopped"  #: ended before its end: by a person, a hold or a fault
    INTERRUPTED = "interrupted"  #: the process that ran or recorded it was gone
    INCOMPLETE = "incomplete"  #: the disk took no more


class RecordingError(CtrError):
    """A recording that cannot be written or read."""
