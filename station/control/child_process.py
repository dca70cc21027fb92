"""Child processes of the station: start, messages through a pipe, end, and evidence that a process is alive.

A parent with a single thread forks the child, which then has all modules and compiled code of its parent: importing
them again takes a second of processor time. A fork of a process with several threads might copy a lock that another
thread has locked, so such a parent starts a new interpreter instead ("spawn"). The station forks its processes before
it starts its first thread; a reset after a crash starts new interpreters.
"""

import contextlib
import gc
import math
import multiprocessing
import os
import select
import signal
import time
from collections.abc import Callable
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from station.control.clock import StationClock
from station.control.realtime import processor_time
from station.control.ring import STATION_HEARTBEAT, Ring

#: Longest wait for the exit status of a process that has already ended, in real time [s].
EXIT_TIME = 5.0
#: Interval between two polls of the exit status [s].
EXIT_INTERVAL = 1e-3


def takes_message(pipe: Connection) -> bool:
    """Return whether a small message can be sent through a pipe now, without waiting for the reader."""
    poller = select.poll()
    poller.register(pipe.fileno(), select.POLLOUT)
    return bool(poller.poll(0))


class ChildProcess:
    """Owner of one child process and of the pipe to it."""

    def __init__(self, main: Callable[..., None], *arguments: Any, name: str, daemon: bool = True) -> None:
        """Start `main(*arguments, pipe, parent)` in a new process.

        Args:
            main: function that the child executes. Its last arguments are the child's end of the pipe, and the
                parent's pid, with which the child detects the end of the parent.
            arguments: first arguments of `main`, before pipe and pid.
            name: name of the child process.
            daemon: True: the child ends with the parent; False: the child may outlive the parent.
        """
        context: Any = multiprocessing.get_context("fork" if _has_one_thread() else "spawn")
        self.pipe, end = context.Pipe()  #: end of the pipe to the child; readable when the child has sent a message
        target, given = _apart, (main, *arguments, end, os.getpid())
        if context.get_start_method() == "fork":
            resource_tracker.ensure_running()  # the child shares this tracker process
            target, given = _forked, (_open_descriptors(), *given)
        self._process = context.Process(target=target, args=given, name=name, daemon=daemon)
        # Until the child has its own session, Ctrl-C in a terminal reaches it, too. So it starts with SIGINT blocked.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        end.close()

    @property
    def alive(self) -> bool:
        """Whether the child process runs."""
        return self._process.is_alive()

    @property
    def pid(self) -> int:
        """Process ID of the child process."""
        return self._process.pid or 0

    def send(self, message: Any) -> None:
        """Send a message to the child process; do nothing if the child has ended."""
        with contextlib.suppress(OSError):
            self.pipe.send(message)

    def ended(self, patience: float | None = None) -> str:
        """Wait at most `patience` [s] for the end of the child; return a text with its signal or exit status."""
        if wait([self._process.sentinel], patience):
            # Only one thread gets the exit status from the system. Until this thread has stored the status, the process
            # seems to run for every other thread.
            deadline = time.monotonic() + EXIT_TIME
            while self._process.exitcode is None and time.monotonic() < deadline:
                time.sleep(EXIT_INTERVAL)
        code = self._process.exitcode
        if code is None:
            return "without an exit status yet"
        return f"by signal {-code}" if code < 0 else f"with status {code}"

    def terminate(self) -> None:
        """Terminate the child process (SIGTERM)."""
        self._process.terminate()

    def kill(self) -> None:
        """Kill the child process (SIGKILL)."""
        self._process.kill()

    def end(self, patience: float) -> None:
        """Request the child's end by the message None; kill the child if it still runs after `patience` [s]."""
        self.send(None)
        if not wait([self._process.sentinel], patience):
            self._process.kill()
        self.ended()

    def close(self, patience: float) -> None:
        """End the child process as `end` does, then close the pipe to it."""
        self.end(patience)
        self.pipe.close()


def _has_one_thread() -> bool:
    """Return whether this process has one thread, including those of libraries; False on other systems than Linux."""
    try:
        return len(list(Path("/proc/self/task").iterdir())) == 1
    except FileNotFoundError:
        return False


def _open_descriptors() -> set[int]:
    """Return the file descriptors of this process (Linux)."""
    found = set[int]()
    for file in list(Path("/proc/self/fd").iterdir()):
        with contextlib.suppress(OSError):  # skip the descriptor with which this function read the list
            os.fstat(int(file.name))
            found.add(int(file.name))
    return found


def _forked(inherited: set[int], main: Callable[..., None], *arguments: Any) -> None:
    """Run `main(*arguments)` in a forked child, after giving up everything that belongs to its parent.

    Args:
        inherited: file descriptors of the parent before the fork.
        main: main function of the child.
        arguments: arguments of `main`; those that are connections stay open.
    """
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    kept = {0, 1, 2, resource_tracker.getfd()}
    kept |= {one.fileno() for one in arguments if isinstance(one, Connection)}
    # An open copy of a socket would keep the station's port busy after the station's end, and a copy of a pipe would
    # hide from its reader that the station has ended. The numbers stay in use, because unused objects of the parent
    # may close them at any time.
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in inherited - kept:
        os.dup2(nothing, descriptor, inheritable=False)
    os.close(nothing)
    gc.freeze()  # a collection would copy the memory that the child shares with its parent
    gc.enable()  # the parent disables it during its start
    _apart(main, *arguments)


def _apart(main: Callable[..., None], *arguments: Any) -> None:
    """Run `main(*arguments)` in a session of its own, which signals from the parent's terminal do not reach."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when its children end
    # A session without a terminal may get one by opening a serial port; pulling its plug then sends SIGHUP.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    main(*arguments)


#: Age of a heartbeat from which on the kernel is queried, and interval between two queries [s].
DOUBT_S, QUERY_INTERVAL_S = 0.2, 0.05


class StationLife:
    """Evidence in the control process that the station process is alive: its heartbeat and its processor time.

    The heartbeat needs the interpreter's lock, which other threads of a busy station process may keep for seconds.
    Therefore the kernel is queried, too: a process that is suspended or starved uses no processor time.
    """

    def __init__(self, ring: Ring, clock: StationClock, pid: int) -> None:
        self._ring, self._clock, self._pid = ring, clock, pid
        self._used: float | None = None  # processor time at the last query; None: no query since the last heartbeat
        self._queried = self._worked = -math.inf

    @property
    def silence(self) -> float:
        """Time since the last heartbeat of the station process [s]."""
        return self._clock.now() - float(self._ring.numbers[STATION_HEARTBEAT])

    def standstill(self) -> float:
        """Return the time since the last heartbeat or use of a processor [s]; call this at every tick."""
        silence, now = self.silence, self._clock.now()
        if silence < DOUBT_S:
            self._used = None
        elif now - self._queried >= QUERY_INTERVAL_S:
            used, self._queried = processor_time(self._pid), now
            if used is not None and self._used not in (None, used):
                self._worked = now
            self._used = used
        return min(silence, now - self._worked)


#: Interval between two reads of a heartbeat [s].
HEARTBEAT_INTERVAL_S = 0.01


def is_alive(ring: Ring, heartbeat: int, clock: StationClock, patience: float) -> bool:
    """Return whether a process writes its heartbeat (an index of the ring's numbers) within `patience` [s].

    A hung process exists, but was stopped by a signal, by swapping or by a suspended computer.
    """
    before, end = float(ring.numbers[heartbeat]), clock.now() + patience
    while float(ring.numbers[heartbeat]) == before:
        if clock.now() > end:
            return False
        clock.sleep(HEARTBEAT_INTERVAL_S)
    return True
