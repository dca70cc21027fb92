"""What the operating system grants a punctual process; what it refuses is said, not hidden."""

import contextlib
import gc
import os
from collections.abc import Iterator
from pathlib import Path


def ask_for_fifo(priority: int = 50) -> bool:
    """Ask for real-time scheduling of the calling thread; False when the system refuses or has none.

    Threads and processes that it starts later do not inherit it.
    """
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (OSError, ValueError):
        return False
    return True


def calm_memory() -> None:
    """No garbage collection pauses: what lives now lives for ever, the loop makes no cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """No garbage collection meanwhile: the control loop makes no cycles, and a collection looks at all there is."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


def show_as(name: str) -> None:
    """Call this process `name` (15 letters at most) where processes are listed, on systems that can."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name, encoding="ascii")
