"""The processes behind a running station: the lab's, the control process, and the watch over both."""

import os
import threading
from collections.abc import Callable
from typing import Any

from station.control.messages import Notice
from station.control.realtime import ask_for_fifo, one_thread_each
from station.control.ring import HEARTBEAT, STATION_HEARTBEAT, Ring
from station.control.states import RefusedError, State
from station.service.backend import Backend
from station.service.bench import Bench
from station.service.control_host import WATCHER_PRIORITY, ControlHost, Ending, Said

#: A control process that has begun to tick and has not for so long is hung: it is ended, the stages are stopped [s].
HUNG = 1.0
#: The same until it has been READY once: the first ticks of a new installation compile what they meet [s].
FIRST_TICKS = 60.0
#: Between two looks of the watchdog [s].
LOOK = 0.02


class Processes:
    """Owner of them, once they are opened; any thread may ask."""

    def __init__(
        self,
        bench: Bench,
        ring: Ring,
        hear: Callable[[Said], None],
        ended: Callable[[Ending], None],
        problem: Callable[[], str],
    ) -> None:
        """No process yet.

        Args:
            bench: what they are in charge of.
            ring: for telemetry.
            hear: called with what the control process says.
            ended: called when it has ended unasked, the stages stopped.
            problem: asked again and again: why a motion must not go on; empty while it may.
        """
        self.lab = Backend(bench, ring)
        self._bench, self._ring, self._clock = bench, ring, bench.clock
        self._hear, self._ended, self._problem = hear, ended, problem
        self._patience = FIRST_TICKS
        self._control: ControlHost | None = None
        self._closing = threading.Event()
        self._watchdog = threading.Thread(target=self._watch, name="watchdog")

    def open(self) -> None:
        """Start them; once."""
        one_thread_each()
        self.lab.open()
        self._start_control()
        self._watchdog.start()

    @property
    def well(self) -> bool:
        """Whether there is nothing to start anew: all of them live, or none was ever started."""
        return self._control is None or (self._control.alive and self.lab.alive)

    def pids(self) -> dict[str, int]:
        """Number of every process that lives."""
        found = {"station": os.getpid()}
        if self._control is not None and self._control.alive:
            found["control"] = self._control.pid
        if self.lab.pid is not None:
            found["lab"] = self.lab.pid
        return found

    def ask(self, what: Any, **about: Any) -> None:
        """Have the control process do something, with what else `Command` says about it.

        Raises:
            RefusedError: the state does not allow it, or there is nobody who answers.
        """
        if self._control is None:
            raise RefusedError("the station was not started: there is no control process")
        self._control.ask(what, **about)

    def stop_stages(self) -> str | None:
        """Stop the stages without the control process: what came of it; None while it lives and is to be asked."""
        if self._control is None:
            return ""
        return None if self._control.alive else self._control.stop_stages()

    def end_dead(self) -> None:
        """Put away what has died, and what cannot go on without it."""
        if self._control is not None:
            if self._control.alive:
                self._control.kill("its devices are gone")
            self._control.close()

    def start_anew(self) -> None:
        """Start what has been put away."""
        if not self.lab.alive:
            self.lab.open()
        self._start_control()

    def close(self) -> None:
        """End the control process, its axes stopped, then the lab."""
        self._closing.set()
        if self._control is not None:
            self._control.close()
        self.lab.close()
        if self._watchdog.is_alive():
            self._watchdog.join(timeout=self._clock.real(3.0))

    def _start_control(self) -> None:
        self._control = ControlHost(self._bench, self._ring, self.lab.devices, self._heard, self._ended)

    def _heard(self, message: Said) -> None:
        if isinstance(message, Notice) and message.state is State.READY:
            self._patience = HUNG
        self._hear(message)

    def _watch(self) -> None:
        """Show the control process that this one lives; end it when it hangs."""
        if self._bench.fifo:
            ask_for_fifo(WATCHER_PRIORITY)
        while not self._closing.wait(self._clock.real(LOOK)):
            now, control = self._clock.now(), self._control
            self._ring.numbers[STATION_HEARTBEAT] = now
            ticked = float(self._ring.numbers[HEARTBEAT])
            if control is None or not control.alive:
                continue
            if ticked > 0.0 and now - ticked > self._patience:
                control.kill(f"the control loop has not ticked for {self._patience:g} s")
            elif problem := self._problem():
                # A run that is not recorded is worth nothing: end it safely.
                control.hold(problem)
