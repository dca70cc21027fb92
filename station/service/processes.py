"""The processes behind a running station: the lab's, the control process, and the watch over both."""

import os
import threading
import traceback
from collections.abc import Callable, Collection
from typing import Any

from station.control.messages import Notice
from station.control.realtime import ask_for_fifo
from station.control.ring import HEARTBEAT, LAB_HEARTBEAT, STATION_HEARTBEAT, Ring
from station.control.states import RefusedError, State
from station.service.backend import Backend
from station.service.bench import Bench
from station.service.control_host import WATCHER_PRIORITY, ControlHost, Ending, Said
from station.service.last_stop import NOTHING, Stopped
from station.service.sign_of_life import goes_on
from station.threads import one_thread_each

#: A control process that has begun to tick and has not for so long is hung: it is ended, the stages are stopped [s].
HUNG = 1.0
#: The same until it has been READY once: the first ticks of a new installation compile what they meet [s].
FIRST_TICKS = 60.0
#: Before a reset a process gets this long to show that it goes on [s].
SIGN_OF_LIFE = 3.0
LAB, CONTROL = "the virtual lab", "the control process"
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
        self._closing, self._changing = threading.Event(), threading.Lock()
        self._watchdog = threading.Thread(target=self._watch, name="watchdog")

    def open(self) -> None:
        """Start them; once."""
        one_thread_each()
        self.lab.open()
        self._start_control()
        self._watchdog.start()

    def gone(self) -> tuple[str, ...]:
        """Those that have died or stand still, in words; a look for a sign of life, which may take a while."""
        control = self._control
        if control is None:
            return ()
        lab_goes_on = self.lab.alive and (self.lab.pid is None or self._goes_on(LAB_HEARTBEAT, SIGN_OF_LIFE))
        found = () if lab_goes_on else (LAB,)
        # Whoever spoke to a lab that has gone has to find the devices of the new one.
        patience = max(SIGN_OF_LIFE, self._patience)
        return found if lab_goes_on and control.alive and self._goes_on(HEARTBEAT, patience) else (*found, CONTROL)

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

    def stop(self, cause: str = "stopped by the operator") -> str:
        """Stop every axis, with the control process or without: what a person should know; empty when it is done."""
        if self._control is None:
            return "there is no control process and nothing that moves"
        return self._control.stop(cause)

    def end_dead(self, gone: Collection[str]) -> None:
        """Put away what is `gone`, and what cannot go on without it."""
        if self._control is not None:
            if self._control.alive:
                self._control.kill(f"it was ended: {' and '.join(gone)} did not go on")
            self._control.close()
        if LAB in gone:
            self.lab.close()

    def start_anew(self) -> None:
        """Start what has been put away.

        Raises:
            RefusedError: the station is ending.
        """
        with self._changing:
            if self.closing:
                raise RefusedError("the station is ending")
            if not self.lab.alive:
                self.lab.open()
            self._start_control()

    @property
    def closing(self) -> bool:
        """Whether the station is ending."""
        return self._closing.is_set()

    def end_control(self) -> Stopped:
        """End the control process, its axes stopped first; none is started any more.

        Returns:
            What has been seen of the stages' stop.
        """
        with self._changing:
            self._closing.set()
        return NOTHING if self._control is None else self._control.close()

    def close(self) -> Stopped:
        """End the control process as `end_control`, then the lab."""
        stopped = self.end_control()
        self.lab.close()
        if self._watchdog.is_alive():
            self._watchdog.join(timeout=self._clock.real(3.0))
        return stopped

    def _goes_on(self, heartbeat: int, patience: float) -> bool:
        return goes_on(self._ring, heartbeat, self._clock, patience)

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
        failures: set[str] = set()
        while not self._closing.wait(self._clock.real(LOOK)):
            try:
                self._look()
            except Exception as error:  # whatever fails, the next look comes
                if repr(error) not in failures:
                    traceback.print_exc()
                failures.add(repr(error))

    def _look(self) -> None:
        now, control = self._clock.now(), self._control
        self._ring.numbers[STATION_HEARTBEAT] = now
        ticked = float(self._ring.numbers[HEARTBEAT])
        if control is None or not control.alive:
            return
        if ticked > 0.0 and now - ticked > self._patience:
            waits_for = f": it waits for {control.waits_for}" if control.waits_for else ""
            control.kill(f"the control loop has not ticked for {self._patience:g} s{waits_for}")
        elif problem := self._problem():
            # A run that is not recorded is worth nothing: end it safely.
            control.hold(problem)
