"""What the operating system grants a punctual process; what it refuses is said, not hidden."""

import contextlib
import gc
import os
from pathlib import Path


def ask_for_fifo(priority: int = 50) -> bool:
    """Ask for real-time scheduling; False when the system refuses or has none."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError):
        return False
    return True


def calm_memory() -> None:
    """No garbage collection pauses: what lives now lives for ever, the loop makes no cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()


def show_as(name: str) -> None:
    """Call this process `name` (15 letters at most) where processes are listed, on systems that can."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name, encoding="ascii")
