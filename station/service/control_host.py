"""The station process's side of control: it starts and hears the control process, and stops the stages after it."""

import itertools
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from station.control.child import Child
from station.control.messages import Command, DeviceReport, Notice, Refused, Reply
from station.control.process import run_control
from station.control.realtime import ask_for_fifo
from station.control.ring import HEARTBEAT, Ring
from station.control.states import Event, RefusedError
from station.devices.config import BenchFile
from station.devices.interfaces import EmergencyStop
from station.devices.registry import emergency_stop
from station.lab.host import LabError
from station.service.bench import Bench

#: The control process answers a command within this time or counts as gone [s].
ANSWER_TIME = 1.0
#: Of the threads that stop the stages when the control process cannot; below its own.
WATCHER_PRIORITY = 45

Said = Notice | DeviceReport | Refused


class Ending(NamedTuple):
    """The control process has ended, though nobody asked it to."""

    how: str  #: by which signal, with which status; or why it had to be
    stopped: str  #: what became of the stages


class ControlHost:
    """Owner of one control process; when that has ended another one is needed."""

    def __init__(
        self,
        bench: Bench,
        ring: Ring,
        devices: Callable[[], BenchFile],
        hear: Callable[[Said], None],
        ended: Callable[[Ending], None],
    ) -> None:
        """Start it.

        Args:
            bench: what it is in charge of.
            ring: for its telemetry.
            devices: where the devices are; may wait, and raise LabError.
            hear, ended: called in a thread of their own with what it says, and when it has ended unasked.
        """
        self._fifo, self._clock = bench.fifo, bench.clock
        self._devices, self._registered, self._hear, self._ended = devices, bench.registered, hear, ended
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._answered = threading.Condition(self._lock)
        self._waiting: set[int] = set()
        self._replies: dict[int, str] = {}
        self._robot = bench.robot
        self._stages = ""  # name of their driver, once they may have been opened
        self._emergency_stop: EmergencyStop | None = None
        self._closing = False
        self._killed = ""  # why, if it was
        ring.numbers[HEARTBEAT] = 0.0
        self._child = Child(run_control, bench.control, ring.name, name="control")
        self._watcher = threading.Thread(target=self._watch, name="control watcher")
        self._watcher.start()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._child.alive

    @property
    def pid(self) -> int:
        """Number of the control process."""
        return self._child.pid

    def ask(self, what: Any, **about: Any) -> None:
        """Have a command carried out, with what else `Command` says about it.

        Raises:
            RefusedError: the state does not allow it, or there is nobody who answers.
        """
        command = Command(next(self._numbers), what, **about)
        with self._lock:
            self._waiting.add(command.number)
        try:
            try:
                with self._lock:
                    self._child.pipe.send(command)
            except OSError:
                raise RefusedError("the control process is gone; reset to start it anew") from None
            with self._answered:
                if not self._answered.wait_for(lambda: command.number in self._replies, self._clock.real(ANSWER_TIME)):
                    raise RefusedError(f"the control process did not answer '{what}' within {ANSWER_TIME:g} s")
                refused = self._replies.pop(command.number)
        finally:
            with self._lock:
                self._waiting.discard(command.number)
        if refused:
            raise RefusedError(refused)

    def hold(self, cause: str) -> None:
        """End a motion; does not wait for an answer."""
        with self._lock:
            self._child.tell(Command(next(self._numbers), Event.HOLD, cause=cause))

    def stop_stages(self) -> str:
        """Stop them without the control process, which is no more: what came of it, in words."""
        if not self._stages:
            return ""
        if self._emergency_stop is None:
            return f"driver '{self._stages}' cannot stop its stages from another process: press the emergency stop"
        try:
            return self._emergency_stop(self._clock)
        except Exception as error:  # whatever an installed driver does
            return f"the stages could not be stopped ({type(error).__name__}: {error}): press the emergency stop"

    def kill(self, why: str) -> None:
        """End it at once; the stages are stopped then, and `why` is told."""
        self._killed = why
        self._child.kill()

    def close(self) -> None:
        """End it, its axes stopped; of one that has ended already only the rest is put away."""
        self._closing = True
        self._child.end(self._clock.real(3.0))
        self._watcher.join(timeout=self._clock.real(5.0))
        self._child.pipe.close()

    def _watch(self) -> None:
        """Give it its devices, take what it says until it ends; its end unasked is a fault."""
        if self._fifo:
            ask_for_fifo(WATCHER_PRIORITY)  # what is left of a run must not wait for a page to be drawn
        try:
            told = self._registered(self._devices())
            self._emergency_stop = emergency_stop(told.stages, self._robot)
            self._stages = str(told.stages["driver"])
            with self._lock:
                self._child.pipe.send(told)
            while True:
                self._take(self._child.pipe.recv())
        except LabError as error:
            self.kill(str(error))
        except (EOFError, OSError):
            pass  # it has ended
        if self._closing:
            return
        stopped = self.stop_stages()
        self._ended(Ending(self._killed or f"the control process ended {self._child.ended()}", stopped))

    def _take(self, message: Reply | Said) -> None:
        if not isinstance(message, Reply):
            self._hear(message)
            return
        with self._answered:
            if message.number in self._waiting:
                self._replies[message.number] = message.refused
                self._answered.notify_all()
