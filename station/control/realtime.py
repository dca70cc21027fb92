"""Request real-time settings of a process (scheduling, locked memory, a processor) and report which are refused."""

import contextlib
import ctypes
import gc
import os
from collections.abc import Iterable, Iterator
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

#: Flags of mlockall(2): lock present pages, lock future pages, and lock pages only when they are used.
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
#: Index of the bit in a process's capabilities that allows it to lock memory (CAP_IPC_LOCK).
_CAP_IPC_LOCK = 14
_SIGKILL = 9


class RealtimeRights(NamedTuple):
    """Real-time settings that `request_realtime` has obtained, and those that were refused."""

    fifo: bool  #: whether the process has real-time scheduling
    refused: tuple[str, ...]  #: human-readable text for each refused setting


def request_realtime(*, fifo: bool, core: int | None) -> RealtimeRights:
    """Prepare the calling process for real time: pin it, lock its memory, request SCHED_FIFO, stop garbage collection.

    Args:
        fifo: request real-time scheduling.
        core: processor to run on; None: any.
    """
    refused: list[str] = []
    if core is not None and not pin_to({core}):
        refused.append(f"the control loop cannot be pinned to processor {core}")
    if not lock_memory():
        refused.append("memory cannot be locked: the loop may have to wait for the disk; ctr-station doctor shows how")
    granted = fifo and request_fifo()
    if fifo and not granted:
        refused.append("SCHED_FIFO is refused: the loop runs with more jitter; ctr-station doctor shows how to get it")
    freeze_garbage_collection()
    gc.disable()  # the control loop needs no collection, because it creates no reference cycles
    return RealtimeRights(granted, tuple(refused))


def request_fifo(priority: int = 50, *, in_turns: bool = False) -> bool:
    """Request real-time scheduling of the calling thread; return False if the system refuses or does not support it.

    Threads and processes that the thread starts later do not inherit the scheduling. `in_turns`: share
    the processor with threads of the same priority in turns (SCHED_RR).
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
    """Lock each page of this process's memory when it is used; return False if the system refuses or cannot do so.

    If the system limits locked memory, nothing is locked: an allocation beyond the limit would fail during a run.
    """
    if not may_lock_memory():
        return False
    lock = getattr(ctypes.CDLL(None, use_errno=True), "mlockall", None)
    return lock is not None and lock(_CURRENT | _FUTURE | _ON_FAULT) == 0


def may_lock_memory() -> bool:
    """Return whether this process may lock all of its memory."""
    try:
        import resource  # this module does not exist on Windows
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


def pin_to(cores: set[int]) -> bool:
    """Run the calling thread and its children on these processors only; return False if that is impossible."""
    if not hasattr(os, "sched_setaffinity"):
        return False
    try:
        os.sched_setaffinity(0, cores)
    except (OSError, ValueError):
        return False
    return True


def last_core() -> int | None:
    """Return the index of the last processor, to reserve it for the control process; None if there is only one."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return cores[-1] if len(cores) > 1 else None


def move_off_core(core: int | None, pids: Iterable[int]) -> None:
    """Move the processes `pids`, with all present and future threads, off processor `core`; None: do nothing.

    Call this function after the processes have started, because their start may use every processor. Processes that
    have ended are skipped.
    """
    if core is None:
        return
    for pid in pids:
        # Repeat until no thread had to move: a thread may have started another thread before it was moved.
        while any(_moved(int(thread.name), core) for thread in _threads(pid)):
            pass


def _threads(pid: int) -> list[Path]:
    try:
        return list(Path(f"/proc/{pid}/task").iterdir())
    except OSError:  # the process has ended
        return []


def _moved(thread: int, core: int) -> bool:
    """Move a thread off a processor; return whether the thread was moved."""
    try:
        cores = os.sched_getaffinity(thread)
        if core not in cores:
            return False
        os.sched_setaffinity(thread, cores - {core})
    except OSError:  # the thread has ended, or it may use no other processor
        return False
    return True


def processor_time(pid: int) -> float | None:
    """Return the processor time used by a process [s]; None if the process is gone or the system reports no time."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return None


#: Start of every cause that blames other programs on this computer.
TOO_BUSY = "this computer was too busy"
#: Advice to the operator of a busy computer.
RELIEF = "close other programs and run 'ctr-station doctor'"


def too_busy(what: str) -> str:
    """Return the cause of a stop after the event `what`, which other programs on this computer have caused."""
    return f"{TOO_BUSY}: {what}; {RELIEF}"


class Life(IntEnum):
    """What the system reports about a process."""

    RUNS = 0
    SUSPENDED = 1  #: stopped by a signal, such as SIGSTOP or Ctrl-Z
    ENDED = 2  #: has ended or is being killed


def life(pid: int) -> Life:
    """Return whether a process runs, is suspended, or has ended or been killed, as far as the system reports it.

    Children of the process and the other ends of its pipes detect the end only after its last thread has ended. On a
    busy computer this takes a tenth of a second.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return Life.RUNS if exists(pid) else Life.ENDED
    status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    pending = int(status.get("SigPnd", "0"), 16) | int(status.get("ShdPnd", "0"), 16)
    state = status.get("State", "")[:1]
    if state in ("Z", "X") or pending >> (_SIGKILL - 1) & 1:
        return Life.ENDED
    return Life.SUSPENDED if state == "T" else Life.RUNS


def exists(pid: int) -> bool:
    """Return whether there is a process with this process ID, of any user."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass  # the process runs and belongs to another user
    return True


def load() -> str:
    """Return a text with the computer's load: the mean number of runnable programs in the last minute."""
    processors = f"{os.cpu_count()} processors"
    return f"load {os.getloadavg()[0]:.0f} on {processors}" if hasattr(os, "getloadavg") else processors


def freeze_garbage_collection() -> None:
    """Shorten the pauses of garbage collection: exempt present objects, so that only later objects are collected."""
    gc.collect()
    gc.freeze()


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Disable garbage collection inside the block: a collection would delay a tick of the control loop, or a start."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


def set_process_name(name: str) -> None:
    """Set the name of this process in process lists (at most 15 letters), if the system supports that."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name, encoding="ascii")
