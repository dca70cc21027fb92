"""Division of a motion into parts at the changes of its load; a part starts when the load starts to change."""

from itertools import pairwise

from station.config.loads import Load


def load_windows(load: Load, duration: float) -> list[tuple[float, float]]:
    """Return start and end of each part of a motion [s]; the first part starts when the load does, at its onset."""
    return list(pairwise((*(time for time in load.changes if time < duration), duration)))


def window_name(start: float) -> str:
    """Return the name of a motion's part in a summary: the time of the load's change at its start, e.g. `2 s`."""
    return f"{start:g} s"
