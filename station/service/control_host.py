"""The station process's side of control: it starts and hears the control process, and stops the stages after it."""

import itertools
import math
import threading
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple

from core.errors import CtrError
from station.control.child import Child
from station.control.installed import called
from station.control.messages import Command, DeviceReport, Notice, Refused, Reply
from station.control.process import run_control
from station.control.realtime import ask_for_fifo
from station.control.ring import CALLED, HEARTBEAT, Ring
from station.control.states import Event, RefusedError
from station.devices.config import BenchFile
from station.service.bench import Bench
from station.service.last_stop import NOTHING, LastStop, Stopped

#: The control process answers a command within this time or counts as gone [s].
ANSWER_TIME = 1.0
#: It has this long to end once it is asked to [s].
END_TIME = 3.0
#: The last stop is over after this time, or hangs [s].
LAST_STOP_TIME = 10.0
#: Of the threads that stop the stages when the control process cannot; below its own.
WATCHER_PRIORITY = 45

Said = Notice | DeviceReport | Refused


class Unanswered(RefusedError):
    """The control process does not answer, though it lives."""


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
        self._fifo, self._clock, self._ring = bench.fifo, bench.clock, ring
        self._devices, self._registered, self._hear, self._ended = devices, bench.registered, hear, ended
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._answered = threading.Condition()
        self._waiting: set[int] = set()
        self._replies: dict[int, str] = {}
        self._deaf = False  # it has ended, and answers nothing more
        self._robot = bench.robot
        self._last_stop: LastStop | None = None  # once the stages may have been opened
        self._stopped = NOTHING
        self._over = threading.Event()  # the process has ended, and the stages have been stopped
        self._closing = False
        self._killed = ""  # why, if it was
        self._told: BenchFile | None = None
        ring.numbers[HEARTBEAT], ring.counters[CALLED] = 0.0, 0
        self._child = Child(run_control, bench.control, ring.name, name="control")
        self._watcher = threading.Thread(target=self._watch, name="control watcher")
        self._watcher.start()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._child.alive

    @property
    def ticking(self) -> bool:
        """Whether its loop has begun; nothing moves before."""
        return float(self._ring.numbers[HEARTBEAT]) > 0.0

    @property
    def waits_for(self) -> str:
        """The installed driver that its loop is just waiting for; empty if there is none."""
        return "" if self._told is None else called(self._ring, self._told)

    @property
    def pid(self) -> int:
        """Number of the control process."""
        return self._child.pid

    def ask(self, what: Any, **about: Any) -> None:
        """Have a command carried out, with what else `Command` says about it.

        Raises:
            Unanswered: it does not answer in time; what moves anything is not carried out any more then.
            RefusedError: the state does not allow it, or the process is gone.
        """
        until = math.inf if what in (Event.STOP, Event.HOLD) else self._clock.now() + ANSWER_TIME
        command = Command(next(self._numbers), what, until=until, **about)
        silent = Unanswered(f"the control process did not answer '{what}' within {ANSWER_TIME:g} s")
        with self._answered:
            self._waiting.add(command.number)
        try:
            # A process that stands still takes nothing more from a full pipe.
            if not self._sending.acquire(timeout=self._clock.real(ANSWER_TIME)):
                raise silent
            gone = RefusedError("the control process is gone; reset to start it anew")
            try:
                self._child.pipe.send(command)
            except OSError:
                raise gone from None
            finally:
                self._sending.release()
            with self._answered:
                self._answered.wait_for(
                    lambda: self._deaf or command.number in self._replies, self._clock.real(ANSWER_TIME)
                )
                if command.number not in self._replies:
                    raise gone if self._deaf else silent
                refused = self._replies.pop(command.number)
        finally:
            with self._answered:
                self._waiting.discard(command.number)
        if refused:
            raise RefusedError(refused)

    def stop(self, cause: str = "stopped by the operator") -> str:
        """Stop every axis, without the control process if it does not do it: what a person should know about it."""
        try:
            self.ask(Event.STOP, cause=cause)
            return ""
        except Unanswered as error:
            if not self.ticking:
                return f"{error}: it is starting, and the stop is the next thing that it does"
            return self._stop_instead(f"{error} and was ended")
        except RefusedError as error:
            if self._last_stop is None:
                return "there is no control process and nothing that moves"
            if self.alive and not self._deaf:
                return self._stop_instead(f"the control process could not stop ({error}) and was ended")
            self._after_it()
            return self._last_stop().text

    def hold(self, cause: str) -> None:
        """End a motion; does not wait for an answer."""
        if self._sending.acquire(blocking=False):
            try:
                self._child.tell(Command(next(self._numbers), Event.HOLD, cause=cause))
            finally:
                self._sending.release()

    def kill(self, why: str) -> None:
        """End it at once; the stages are stopped then, and `why` is told."""
        self._killed = self._killed or why
        self._child.kill()

    def close(self) -> Stopped:
        """End it, its axes stopped; of one that has ended already only the rest is put away.

        Returns:
            What has been seen of the stages' stop.
        """
        self._closing = True
        if self.alive and self.ticking:
            try:
                self.ask(Event.STOP)
            except RefusedError:
                self._child.kill()  # one that does not listen stops nothing
        self._child.end(self._clock.real(END_TIME))
        stopped = self._after_it()
        self._child.pipe.close()
        if self._last_stop is not None:
            self._last_stop.close()
        return stopped

    def _stop_instead(self, why: str) -> str:
        """Stop the stages in the place of a process that lives and does not; what came of it, in words."""
        waits_for = self.waits_for
        why = f"{why}; it was waiting for {waits_for}" if waits_for else why
        self.kill(why)
        return f"{why}; {self._after_it().text}"

    def _after_it(self) -> Stopped:
        """What has become of the stages once the process has ended."""
        if self._over.wait(self._clock.real(LAST_STOP_TIME)) or self._last_stop is None:
            return self._stopped
        return Stopped(False, "the last stop of the stages does not come to an end: press the emergency stop")

    def _watch(self) -> None:
        """Give it its devices, take what it says until it ends, stop the stages; its end unasked is a fault."""
        if self._fifo:
            ask_for_fifo(WATCHER_PRIORITY)  # what is left of a run must not wait for a page to be drawn
        try:
            self._listen()
        except CtrError as error:
            self.kill(str(error))
        except Exception as error:  # nobody else would stop the stages
            traceback.print_exc()
            self.kill(f"the station could not go on with the control process ({type(error).__name__}: {error})")
        with self._answered:  # nobody waits for the answer of one that has ended
            self._deaf = True
            self._answered.notify_all()
        if self._last_stop is not None:
            self._stopped = self._last_stop()
        if not self._closing:
            how = self._killed or f"the control process ended {self._child.ended()}"
            self._ended(Ending(how, self._stopped.text))
        self._over.set()

    def _listen(self) -> None:
        self._told = told = self._registered(self._devices())
        self._last_stop = LastStop(told.stages, self._robot, self._clock)
        try:
            with self._sending:
                self._child.pipe.send(told)
            while True:
                message = self._child.pipe.recv()
                try:
                    self._take(message)
                except Exception:  # whatever becomes of one message, the next one is heard
                    traceback.print_exc()
        except (EOFError, OSError):
            return  # it has ended

    def _take(self, message: Reply | Said) -> None:
        if not isinstance(message, Reply):
            self._hear(message)
            return
        with self._answered:
            if message.number in self._waiting:
                self._replies[message.number] = message.refused
                self._answered.notify_all()
