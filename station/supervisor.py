"""The station process's side of control: starts the control process, asks it, watches it.

Everything a browser or a script may want goes through `Supervisor`; it never touches a device.
"""

import contextlib
import itertools
import multiprocessing
import os
import threading
import time
from collections.abc import Mapping
from datetime import datetime
from typing import Any, NamedTuple

from core.errors import CtrError
from core.robot import Array
from core.statics import Statics
from station.control_process import Bench, Command, Notice, Reply, ring_width, run_control
from station.lab.loads import Load, NoLoad
from station.loop import Phase, Task
from station.ring import HEARTBEAT, PHASE, PROGRESS, RUN, STATE, Ring, Timing
from station.states import Event, RefusedError, State
from station.telemetry import Channels

#: The control process answers a command within this time or counts as gone [s].
ANSWER_TIME = 1.0
#: Telemetry older than this is shown as stale [s].
STALE = 0.5


class Status(NamedTuple):
    """One look says everything."""

    state: State
    cause: str  #: why it is HOLD, STOPPED or FAULT
    run: str  #: the run that is on, or the last one; empty before the first
    title: str  #: of that run
    phase: Phase
    progress: float  #: part of the motion that is done
    age: float  #: since the last tick [s]
    timing: Timing
    values: Mapping[str, Array]  #: newest telemetry by group; empty until there is some


class Supervisor:
    """Owner of the control process."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.robot = bench.robot.robot()
        self.channels = Channels(self.robot)
        self.statics = Statics(self.robot)
        self.ring = Ring(ring_width(bench.robot))
        self.task: Task | None = None  #: what the run that is on, or the last one, has to do
        self._session = f"{datetime.now().astimezone():%Y%m%d-%H%M%S}"
        self._numbers = itertools.count(1)
        self._runs = itertools.count(1)
        self._lock = threading.Lock()
        self._replies: dict[int, str] = {}
        self._answered = threading.Condition(self._lock)
        self._cause = ""
        self._state = State.OFF
        self._run, self._title = 0, ""
        self._closing = False
        self._context = multiprocessing.get_context("spawn")
        self._start_process()

    def wait_ready(self, timeout: float, since: int = 0) -> None:
        """Wait until the loop ticks and telemetry has gone beyond row `since`.

        Raises:
            CtrError: it does not, in `timeout` [s].
        """
        deadline = time.monotonic() + timeout
        while self.ring.written <= since:
            if self._state is State.FAULT:
                raise CtrError(f"the control process did not start: {self._cause}")
            if time.monotonic() > deadline:
                raise CtrError(f"the control process did not start within {timeout:g} s")
            time.sleep(0.02)

    def status(self) -> Status:
        """The present state, timing and newest telemetry."""
        counters, numbers = self.ring.counters, self.ring.numbers
        row = self.ring.latest()
        groups = {} if row is None else {name: self.channels.of(row, name) for name in self.channels.groups}
        with self._lock:
            # A dead process cannot say so itself.
            state = self._state if self._state in (State.OFF, State.FAULT) else State(int(counters[STATE]))
            return Status(
                state, self._cause if state in (State.HOLD, State.STOPPED, State.FAULT) else "", self._run_id(),
                self._title, Phase(int(counters[PHASE])) if int(counters[RUN]) == self._run else Phase.NONE,
                float(numbers[PROGRESS]), time.monotonic() - float(numbers[HEARTBEAT]), self.ring.timing(), groups,
            )  # fmt: skip

    def start(self, task: Task, load: Load, title: str) -> str:
        """Start a run; its id.

        Raises:
            RefusedError: the state does not allow it.
        """
        number = next(self._runs)
        self._ask(Event.START, task, load, number)
        with self._lock:
            self._run, self._title, self.task = number, title, task
            return self._run_id()

    def stop(self) -> None:
        """Stop every axis. Without a control process there is nothing to stop: the virtual lab lives in it."""
        if self._process.is_alive():
            self._ask(Event.STOP)

    def reset(self) -> None:
        """A person has seen the fault, stop or hold; a dead control process is started anew.

        Raises:
            RefusedError: there is nothing to reset.
            CtrError: the control process does not come back.
        """
        if self._process.is_alive():
            self._ask(Event.RESET)
            return
        self._watcher.join(timeout=ANSWER_TIME)
        self._pipe.close()
        self.ring.clear_timing()
        since = self.ring.written
        with self._lock:
            self._cause, self._state, self._run, self._title, self.task = "", State.OFF, 0, "", None
        self._start_process()
        self.wait_ready(60.0, since)

    def close(self) -> None:
        """End the control process, its axes stopped, and remove the shared memory."""
        self._closing = True
        with contextlib.suppress(OSError):  # it may be gone already
            self._pipe.send(None)
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._watcher.join(timeout=2.0)
        self._pipe.close()
        self.ring.close(remove=True)

    def _run_id(self) -> str:
        return f"{self._session}-{self._run}" if self._run else ""

    def _start_process(self) -> None:
        self._pipe, child = self._context.Pipe()
        self._process = self._context.Process(
            target=run_control, args=(self.bench, self.ring.name, child, os.getpid()), name="control", daemon=True
        )
        self._process.start()
        child.close()
        self._watcher = threading.Thread(target=self._watch, args=(self._pipe, self._process), name="control watcher")
        self._watcher.start()

    def _ask(self, event: Event, task: Task | None = None, load: Load | None = None, run: int = 0) -> None:
        number = next(self._numbers)
        try:
            with self._lock:
                self._pipe.send(Command(number, event, task, load or NoLoad(), run))
        except OSError:
            raise RefusedError("the control process is gone; reset to start it anew") from None
        with self._answered:
            if not self._answered.wait_for(lambda: number in self._replies, ANSWER_TIME):
                raise RefusedError(f"the control process did not answer '{event}' within {ANSWER_TIME:g} s")
            refused = self._replies.pop(number)
        if refused:
            raise RefusedError(refused)

    def _watch(self, pipe: Any, process: Any) -> None:
        """Take replies and notices until the process ends; its end unasked is a fault."""
        try:
            while True:
                message: Reply | Notice = pipe.recv()
                with self._answered:
                    if isinstance(message, Reply):
                        self._replies[message.number] = message.refused
                        self._answered.notify_all()
                    else:
                        self._state, self._cause = message.state, message.cause
        except (EOFError, OSError):
            process.join()
        if not self._closing:
            code = process.exitcode
            how = f"by signal {-code}" if code is not None and code < 0 else f"with status {code}"
            with self._lock:
                self._state = State.FAULT
                self._cause = f"the control process ended {how}, and the virtual lab with it; reset to start both anew"
