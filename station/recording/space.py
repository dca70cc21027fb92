"""Check of the free disk space for a recording before a run starts."""

import os
import shutil
from pathlib import Path

#: Largest growth of a recording [bytes/s]: 500 rows of about 160 numbers that cannot be compressed, and 10 drawings.
#: Random numbers with two tubes need 711 kB/s; a real run needs about half of this.
RECORDING_BYTES_PER_S = 750_000.0
#: Disk space that stays free for other programs [bytes].
FREE_SPACE_BYTES = 100e6


def free_space_problem(folder: Path, duration: float) -> str:
    """Return why a recording of `duration` [s] does not fit into `folder`, with what to do; empty if it fits."""
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    if not os.access(existing, os.W_OK):
        return f"{folder}: recordings cannot be written; choose another folder or change its permissions"
    free, needed = shutil.disk_usage(existing).free, RECORDING_BYTES_PER_S * duration + FREE_SPACE_BYTES
    if free >= needed:
        return ""
    return (
        f"{folder}: {free / 1e6:.0f} MB are free, a recording of {duration:g} s needs {needed / 1e6:.0f} MB;"
        " delete old runs or shorten this one"
    )
