"""What the operating system grants a punctual process; what it refuses is said, not hidden."""

import contextlib
import ctypes
import gc
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

#: Of mlockall(2): what is there, what comes, and both only once it is used.
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
#: Bit of the right to lock memory in a process's capabilities.
_CAP_IPC_LOCK = 14
_SIGKILL = 9


class Granted(NamedTuple):
    """What came of it."""

    fifo: bool  #: real-time scheduling
    refused: tuple[str, ...]  #: for a person


def be_punctual(*, fifo: bool, core: int | None) -> Granted:
    """Everything that keeps the calling process punctual: a processor, memory that stays, SCHED_FIFO, no collections.

    Args:
        fifo: ask for real-time scheduling.
        core: the processor to keep to; None: any.
    """
    refused: list[str] = []
    if core is not None and not keep_to({core}):
        refused.append(f"the control loop may not keep to processor {core}")
    if not lock_memory():
        refused.append("memory cannot be locked: the loop may have to wait for the disk; ctr-station doctor says how")
    granted = fifo and ask_for_fifo()
    if fifo and not granted:
        refused.append("SCHED_FIFO is refused: the loop runs with more jitter; ctr-station doctor says how to get it")
    calm_memory()
    return Granted(granted, tuple(refused))


def ask_for_fifo(priority: int = 50, *, in_turns: bool = False) -> bool:
    """Ask for real-time scheduling of the calling thread; False when the system refuses or has none.

    Threads and processes that it starts later do not inherit it. `in_turns`: others of the same priority get
    their turns, too (SCHED_RR).
    """
    if not hasattr(os, "sched_setscheduler"):
        return False
    policy = os.SCHED_RR if in_turns else os.SCHED_FIFO
    try:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (OSError, ValueError):
        return False
    return True


def lock_memory() -> bool:
    """Keep this process's memory from being swapped out, as it is used; False where the system refuses or cannot.

    Under a limit nothing is locked: memory that is asked for beyond it would be refused later, in the middle of a run.
    """
    if not may_lock_memory():
        return False
    lock = getattr(ctypes.CDLL(None, use_errno=True), "mlockall", None)
    return lock is not None and lock(_CURRENT | _FUTURE | _ON_FAULT) == 0


def may_lock_memory() -> bool:
    """Whether the system lets this process lock all of its memory."""
    try:
        import resource  # not on Windows
    except ImportError:
        return False
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return False
    capable = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
    return bool(int(capable, 16) >> _CAP_IPC_LOCK & 1)


def keep_to(cores: set[int]) -> bool:
    """Run the calling thread, and what it starts, on these processors only; False where that cannot be."""
    if not hasattr(os, "sched_setaffinity"):
        return False
    try:
        os.sched_setaffinity(0, cores)
    except (OSError, ValueError):
        return False
    return True


def last_core() -> int | None:
    """Number of the last processor that this process may use, for the control process alone; None if it is the only."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return cores[-1] if len(cores) > 1 else None


def leave(core: int | None, pids: Iterable[int]) -> None:
    """Keep the processes `pids`, with every thread that they have and will have, off a processor; None: they stay.

    Once they are up: what is loaded at the start may use every processor. One that has ended is left out.
    """
    if core is None:
        return
    for pid in pids:
        # Until none is found that had to move: one that had not moved yet may have started another.
        while any(_moved(int(thread.name), core) for thread in _threads(pid)):
            pass


def _threads(pid: int) -> list[Path]:
    try:
        return list(Path(f"/proc/{pid}/task").iterdir())
    except OSError:  # it has ended
        return []


def _moved(thread: int, core: int) -> bool:
    """Keep a thread off a processor; whether that had to be done, and could."""
    try:
        cores = os.sched_getaffinity(thread)
        if core not in cores:
            return False
        os.sched_setaffinity(thread, cores - {core})
    except OSError:  # it has ended, or has no other processor
        return False
    return True


def is_dying(pid: int) -> bool:
    """Whether a process has been killed or has ended, as far as the system tells.

    Its children and the other ends of its pipes learn it only when the last of its threads has gone, which on a
    busy computer takes a tenth of a second.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return False
    told = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    pending = int(told.get("SigPnd", "0"), 16) | int(told.get("ShdPnd", "0"), 16)
    return told.get("State", "")[:1] in ("Z", "X") or bool(pending >> (_SIGKILL - 1) & 1)


def calm_memory() -> None:
    """No garbage collection pauses: what lives now lives for ever, the loop makes no cycles."""
    keep_memory()
    gc.disable()


def keep_memory() -> None:
    """Short garbage collection pauses: what lives now lives for ever, only what comes later is looked at."""
    gc.collect()
    gc.freeze()


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
