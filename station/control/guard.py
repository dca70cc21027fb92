"""The guard: stops the stages when neither the control process nor the station process can do it any more.

All other processes of the station keep a `Watch`. When the control process has ended or is suspended, the first one in
the order of `Rank` that still runs stops the stages: usually the station process (`service/fallback_stop.py`), after it
the guard. The guard does nothing else: it has no files and no clients, and ignores all signals that can be ignored.
"""

import contextlib
import os
import pickle
import select
import signal
import sys
import threading
from collections.abc import Iterator
from enum import IntEnum
from multiprocessing.connection import Connection
from typing import Any

from station.config.robots import RobotFile
from station.control.child_process import ChildProcess
from station.control.clock import StationClock
from station.control.realtime import Life, life, request_fifo, set_process_name
from station.control.ring import DRIVER, HEARTBEAT, RANKS, STATION_HEARTBEAT, WATCHERS, Ring
from station.devices.config import BenchFile
from station.devices.interfaces import EmergencyStop
from station.devices.registry import emergency_stop

#: Interval between two looks at the other processes [s].
LOOK_INTERVAL_S = 0.02
#: Time without a heartbeat of the station process after which it counts as unable to stop the stages [s].
STATION_SILENT_S = 0.3
#: Time without a tick after which a control process counts as hung, if the station process cannot judge it [s].
CONTROL_SILENT_S = 1.0
#: Number of attempts to stop the stages.
ATTEMPTS = 5
#: Time for which an ending process waits for the stop of the stages by a process of a lower rank [s].
FINISH_S = 10.0
#: Real-time priority of the guard; it is below that of the control loop (50).
PRIORITY = 45


class Rank(IntEnum):
    """Order in which the processes stop the stages in place of the control process."""

    STATION, GUARD, RECORDER, GATEWAY, CAMERA, CALIBRATION = range(RANKS)


def brief(ring: Ring, bench: BenchFile, robot: RobotFile) -> None:
    """Write down for every `Watch` how the stages of the bench are stopped."""
    ring.write_briefing(pickle.dumps((dict(bench.stages), robot)))


class Watch:
    """One process's watch over those that must stop the stages before it."""

    def __init__(self, ring: Ring, rank: Rank, clock: StationClock) -> None:
        self._ring, self._rank, self._clock = ring, rank, clock
        self._driver = 0  # process ID of the control process for which the members below are valid
        self._attempts = 0
        self._stop: EmergencyStop | None = None
        ring.counters[WATCHERS + rank] = os.getpid()

    def look(self) -> None:
        """Stop the stages if that is this process's turn."""
        driver = int(self._ring.counters[DRIVER])
        if driver != self._driver:
            self._driver, self._attempts, self._stop = driver, 0, None
            if driver:
                # Load the driver now: later this process may lack memory or file descriptors.
                with contextlib.suppress(Exception):  # the control process reports what is wrong with the stages
                    stages, robot = pickle.loads(self._ring.briefing())  # noqa: S301 - memory of this user only
                    self._stop = emergency_stop(stages, robot)
        if self._stop is not None and self._left and self._is_lost(driver) and self.is_first:
            self._carry_out(driver, self._stop)

    def finish(self) -> None:
        """Wait until the stages are stopped; return earlier if a process of a lower rank can stop them.

        If that is the station process, return at once; another one, such as the guard, has `FINISH_S` for it, because
        whatever has ended the station process may also end the others, one after the other.
        """
        give_up = self._clock.now() + FINISH_S
        self.look()
        while self._left:
            self._clock.sleep(LOOK_INTERVAL_S)  # the system may still count a process that is ending as running
            self.look()
            station = int(self._ring.counters[WATCHERS + Rank.STATION])
            if not self.is_first and (life(station) is Life.RUNS or self._clock.now() > give_up):
                return

    @property
    def is_first(self) -> bool:
        """Whether no process of a lower rank can stop the stages."""
        return not any(self._acts(rank) for rank in Rank if rank < self._rank)

    @property
    def _left(self) -> bool:
        """Whether there are stages that this process can stop, and attempts left."""
        return self._stop is not None and bool(self._ring.counters[DRIVER]) and self._attempts < ATTEMPTS

    def _is_lost(self, driver: int) -> bool:
        if life(driver) is not Life.RUNS:
            return True
        silence = self._clock.now() - float(self._ring.numbers[HEARTBEAT])
        return silence > CONTROL_SILENT_S and not self._acts(Rank.STATION)

    def _acts(self, rank: Rank) -> bool:
        pid = int(self._ring.counters[WATCHERS + rank])
        if not pid or life(pid) is not Life.RUNS:
            return False
        silence = self._clock.now() - float(self._ring.numbers[STATION_HEARTBEAT])
        return rank is not Rank.STATION or silence < STATION_SILENT_S

    def _carry_out(self, driver: int, stop: EmergencyStop) -> None:
        self._attempts += 1
        with contextlib.suppress(OSError):
            os.kill(driver, signal.SIGKILL)  # a suspended process keeps the ports of the stages
        stopped = False
        try:
            done: Any = stop(self._clock)  # an installed driver may return or raise anything
            stopped, text = isinstance(done, str) and done.strip() != "", f"the other processes are gone; {done}"
        except BaseException as error:
            text = f"the stages could not be stopped ({type(error).__name__})"
            with contextlib.suppress(Exception):
                text = str(error) or text
        if stopped and int(self._ring.counters[DRIVER]) == driver:
            self._ring.counters[DRIVER] = 0
        with contextlib.suppress(OSError, ValueError):  # the terminal may be closed
            sys.stderr.write(f"ctr-station: {text}\n")


class BackgroundWatch:
    """A watch in a thread of its own, for processes that have another task."""

    def __init__(self, ring: Ring, rank: Rank, clock: StationClock) -> None:
        self._watch, self._clock = Watch(ring, rank, clock), clock
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, but not before this process has stopped the stages if that is its turn."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._closing.wait(self._clock.real(LOOK_INTERVAL_S)):
            self._watch.look()
        self._watch.finish()


@contextlib.contextmanager
def watching(ring_name: str, width: int, rank: Rank, clock: StationClock, parent: int) -> Iterator[Ring]:
    """Open the telemetry ring in a process with another task, which keeps a watch at `rank` meanwhile."""
    ring = Ring(width, ring_name)
    watch = BackgroundWatch(ring, rank, clock)
    try:
        yield ring
    finally:
        watch.close()
        ring.close(remove=os.getppid() != parent)


def run_guard(ring_name: str, width: int, clock: StationClock, pipe: Connection, parent: int) -> None:
    """Run the guard until the station process ends it, or has ended and the stages are stopped."""
    ended: list[int] = []
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD}:
        with contextlib.suppress(OSError, ValueError):  # some signals belong to the system's libraries
            signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, _: ended.append(number))
    set_process_name("ctr-guard")
    request_fifo(PRIORITY)
    ring = Ring(width, ring_name)
    watch = Watch(ring, Rank.GUARD, clock)
    messages = select.poll()
    messages.register(pipe, select.POLLIN)
    with contextlib.suppress(EOFError, OSError):  # the station process has ended
        while not ended:
            watch.look()
            if messages.poll(1e3 * clock.real(LOOK_INTERVAL_S)) and pipe.recv() is None:
                break
    watch.finish()
    ring.close(remove=os.getppid() != parent)


class Guard:
    """Owner of the guard's process; a new process needs a new object."""

    def __init__(self, ring: Ring, width: int, clock: StationClock) -> None:
        self._child = ChildProcess(run_guard, ring.name, width, clock, name="guard")
        self.pid = self._child.pid  #: process ID of the guard

    @property
    def runs(self) -> bool:
        """Whether the guard runs and is not suspended."""
        return self._child.alive and life(self.pid) is Life.RUNS

    def close(self, patience: float) -> None:
        """End the process; kill it if it still runs after `patience` [s]."""
        self._child.close(patience)
