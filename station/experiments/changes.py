"""The parts of a motion between two changes of its load: from each moment on at which the load begins to change."""

from itertools import pairwise

from station.lab.loads import Load


def windows(load: Load, duration: float) -> list[tuple[float, float]]:
    """Begin and end of each part [s], the first one from the load's onset, the last one to the motion's end."""
    return list(pairwise((*(time for time in load.changes if time < duration), duration)))


def window_name(begin: float) -> str:
    """What a part is called in a summary: by the time of its change."""
    return f"{begin:g} s"
