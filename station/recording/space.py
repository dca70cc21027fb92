"""Whether a disk has room for a recording, asked before a run starts."""

import os
import shutil
from pathlib import Path

#: What a recording takes [bytes/s]: 500 rows of about a hundred numbers compressed to three quarters, and
#: 10 pictures (measured: 400 kB/s with two tubes), with something to spare.
RATE = 650_000.0
#: Left free on the disk for everybody else [bytes].
RESERVE = 100e6


def free_space_problem(folder: Path, duration: float) -> str:
    """Why a recording of `duration` [s] cannot be kept in `folder`, and what to do; empty when it can."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not os.access(there, os.W_OK):
        return f"{folder}: recordings cannot be written there; give another folder or the right to write"
    free, needed = shutil.disk_usage(there).free, RATE * duration + RESERVE
    if free >= needed:
        return ""
    return (
        f"{folder}: {free / 1e6:.0f} MB are free, a recording of {duration:g} s needs {needed / 1e6:.0f} MB;"
        " delete old runs or shorten this one"
    )
