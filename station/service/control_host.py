"""Owner of the control process: starts it, receives its reports, and stops the stages after its end."""

import itertools
import math
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

from core.errors import CtrError
from station.control.child_process import ChildProcess
from station.control.commands import CommandMessage, ControlCommand, Hold, Reply, Reset, Stop
from station.control.driver_guard import driver_in_call
from station.control.guard import brief
from station.control.messages import CommandRefused, DeviceReport, StateNotice
from station.control.process import run_control
from station.control.realtime import request_fifo
from station.control.ring import DRIVEN, DRIVER, DRIVER_IN_CALL, HEARTBEAT, Ring
from station.control.states import RefusedError
from station.devices.config import BenchFile
from station.service.fallback_stop import NO_STAGES, PRESS, PRIORITY, FallbackStop, StopOutcome
from station.service.permits import Permit
from station.service.station_file import Rig

#: Longest time for the control process to answer a command [s]; after it the process counts as hung.
REPLY_TIMEOUT_S = 1.0
#: Number of short waits that `REPLY_TIMEOUT_S` is divided into. A delay of the station process uses up only one of
#: these waits, so that this process still reads an answer that has arrived meanwhile.
ANSWER_SLICES = 20
#: Longest time for the control process to end after the request to end [s]; after it the process is killed.
EXIT_TIMEOUT_S = 3.0
#: Longest time until a STOP request is answered, even if the stages have not confirmed the stop [s].
STOP_REPLY_TIMEOUT_S = 2.8
#: Longest time that the end of the station waits for an attempt to stop the stages [s].
FALLBACK_STOP_TIMEOUT_S = 8.0
#: Real-time priority of the thread that watches the control process; it is below that of the control process.
WATCHER_PRIORITY = PRIORITY

#: Answer to a STOP while there is no control process.
NOTHING_MOVES = StopOutcome(True, "there is no control process and nothing moves")

ControlReport = StateNotice | DeviceReport | CommandRefused | StopOutcome


class NoReply(RefusedError):
    """The control process runs but does not answer."""


class ExitReport(NamedTuple):
    """Report about an unexpected end of the control process."""

    how: str  #: signal or exit status of the process, or why it was killed
    stages: str  #: what happens to the stages now; a `StopOutcome` follows
    details: str = ""  #: values that belong to `how`


class ControlHost:
    """Owner of one control process; a new process needs a new host."""

    def __init__(
        self,
        bench: Rig,
        ring: Ring,
        devices: Callable[[], BenchFile],
        on_report: Callable[[ControlReport], None],
        on_exit: Callable[[ExitReport], None],
    ) -> None:
        """Start the control process.

        Args:
            bench: rig that the process controls.
            ring: shared memory for its telemetry.
            devices: returns the devices to open; may wait, and raise LabError.
            on_report: called in the watcher's thread with each report of the process. After an unexpected end of the
                process, `on_report` also receives a `StopOutcome`, and a second one if the outcome changes.
            on_exit: called in the watcher's thread after an unexpected end of the process.
        """
        self._fifo, self._clock, self._ring = bench.fifo, bench.clock, ring
        self._devices, self._registered = devices, bench.registered
        self._on_report, self._on_exit = on_report, on_exit
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._answered = threading.Condition()
        self._waiting: set[int] = set()
        self._replies: dict[int, str] = {}
        self._ended = False  # whether the process has ended, so that it sends no more answers
        self._robot = bench.robot
        self._fallback: FallbackStop | None = None  # exists before the control process may open the stages
        self._attempt: Future[StopOutcome] | None = None  # attempt to stop the stages after the end of the process
        self._over = threading.Event()  # set when the process has ended and the attempt to stop its stages has started
        self._closing = False
        self._killed = ("", "")  # reason for killing the process, and its details; empty if it was not killed
        self._opened: BenchFile | None = None  # devices that the process was instructed to open
        ring.numbers[HEARTBEAT], ring.counters[DRIVER_IN_CALL] = 0.0, 0
        self._child = ChildProcess(run_control, bench.control, ring.name, name="control")
        self._watcher = threading.Thread(target=self._watch, name="control watcher")
        self._watcher.start()

    @property
    def alive(self) -> bool:
        """Whether the control process runs."""
        return self._child.alive

    @property
    def ticking(self) -> bool:
        """Whether the loop of the control process has started; nothing moves before that."""
        return float(self._ring.numbers[HEARTBEAT]) > 0.0

    @property
    def waits_for(self) -> str:
        """Name of the custom driver or loop whose call the control loop is waiting for; empty if there is none."""
        return "" if self._opened is None else driver_in_call(self._ring, self._opened)

    @property
    def pid(self) -> int:
        """Process ID of the control process."""
        return self._child.pid

    def send(self, command: ControlCommand, permit: Permit | None = None) -> None:
        """Send a command and wait for its answer; a command with a permit is sent only while the permit is valid.

        Raises:
            NoReply: the process does not answer in time; a command that moves the robot then expires.
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the command, or the process has ended.
        """
        deadline = self._clock.now() + REPLY_TIMEOUT_S
        until = math.inf if isinstance(command, Stop | Hold) else deadline
        message = CommandMessage(next(self._numbers), command, until)
        # A reset needs no generation: a later STOP follows it through the same pipe.
        if permit is not None and not isinstance(command, Reset):
            message = message._replace(until=min(until, permit.until), generation=permit.generation)
        silent = NoReply(f"the control process did not answer '{command.name}' within {REPLY_TIMEOUT_S:g} s")
        with self._answered:
            self._waiting.add(message.number)
        try:
            # Another thread may keep this lock for long, because a hung process does not empty a full pipe.
            if not self._sending.acquire(timeout=self._left(deadline)):
                raise silent
            gone = RefusedError("the control process has ended; reset to restart it")
            try:
                if permit is not None:
                    permit.commit(command.name)
                self._child.pipe.send(message)
            except OSError:
                raise gone from None
            finally:
                self._sending.release()
            with self._answered:
                for _ in range(math.ceil(ANSWER_SLICES * (deadline - self._clock.now()) / REPLY_TIMEOUT_S)):
                    slice_time = self._clock.real(REPLY_TIMEOUT_S / ANSWER_SLICES)
                    if self._answered.wait_for(lambda: self._ended or message.number in self._replies, slice_time):
                        break
                if message.number not in self._replies:
                    raise gone if self._ended else silent
                refused = self._replies.pop(message.number)
        finally:
            with self._answered:
                self._waiting.discard(message.number)
        if refused:
            if permit is not None:
                permit.check(command.name)  # raises with the name of the STOP or reset that came in between
            raise RefusedError(refused)

    def stop(self, cause: str = "stopped by the operator") -> StopOutcome:
        """Stop every axis, without the control process if necessary, within `STOP_REPLY_TIMEOUT_S`.

        Returns:
            Whether every axis is known to be at rest, and what the operator must know; usually nothing.
        """
        deadline = self._clock.now() + STOP_REPLY_TIMEOUT_S
        try:
            self.send(Stop(cause=cause))
            return NO_STAGES
        except NoReply as error:
            if not self.ticking:
                return StopOutcome(True, f"{error}: it is starting and will execute the stop first")
            return self._stop_instead(f"{error} and was ended", deadline)
        except RefusedError as error:
            if self.alive and not self._ended:
                return self._stop_instead(f"the control process could not stop ({error}) and was ended", deadline)
            if not self._over.wait(self._left(deadline)) or self._fallback is None or not self._driven:
                outcome = self._outcome(deadline)
                return outcome if outcome.text else NOTHING_MOVES
            return self._fallback(deadline - self._clock.now())

    def hold(self, cause: str) -> None:
        """Send a command that ends a motion in HOLD; do not wait for its answer."""
        if self._sending.acquire(blocking=False):
            try:
                self._child.send(CommandMessage(next(self._numbers), Hold(cause)))
            finally:
                self._sending.release()

    def kill(self, why: str, details: str = "") -> None:
        """Kill the control process, stop the stages and report `why`, with `details` such as raw values."""
        if not self._killed[0]:
            self._killed = why, details
        self._child.kill()

    def close(self) -> StopOutcome:
        """Stop every axis, end the control process and release its resources.

        Returns:
            Outcome of stopping the stages.
        """
        self._closing = True
        if self.alive and self.ticking:
            try:
                self.send(Stop())
            except RefusedError:
                self._child.kill()  # a process that does not answer cannot stop the stages
        self._child.end(self._clock.real(EXIT_TIMEOUT_S))
        stopped = self._outcome(self._clock.now() + FALLBACK_STOP_TIMEOUT_S)
        self._child.pipe.close()
        if self._fallback is not None:
            self._fallback.close(FALLBACK_STOP_TIMEOUT_S)
        return stopped

    def _stop_instead(self, why: str, deadline: float) -> StopOutcome:
        """Kill a process that does not stop the stages; return the outcome of the fallback stop, with the reason."""
        waits_for = self.waits_for
        why = f"{why}; it was waiting for {waits_for}" if waits_for else why
        self.kill(why)
        outcome = self._outcome(deadline)
        return StopOutcome(outcome.confirmed, f"{why}; {outcome.text}")

    def _outcome(self, deadline: float) -> StopOutcome:
        """Return the outcome of stopping the stages after the process has ended, as known at the deadline [s]."""
        if not self._over.wait(self._left(deadline)):
            return StopOutcome(False, f"the control process does not end and may still drive the stages: {PRESS}")
        if self._attempt is None or self._fallback is None:
            return NO_STAGES
        # Repeated calls wait only once for an attempt that hangs.
        patience = min(deadline - self._clock.now(), FALLBACK_STOP_TIMEOUT_S - self._fallback.age)
        return self._fallback.outcome(self._attempt, patience)

    @property
    def _driven(self) -> bool:
        """Whether this station has driven the stages."""
        return bool(self._ring.counters[DRIVEN])

    def _left(self, deadline: float) -> float:
        """Return the real time until the deadline [s]."""
        return self._clock.real(max(0.0, deadline - self._clock.now()))

    def _watch(self) -> None:
        """Send the devices, receive reports until the process ends, then stop the stages and report the end."""
        if self._fifo:
            request_fifo(WATCHER_PRIORITY)  # stopping the stages must not wait for a browser that draws the page
        try:
            self._listen()
        except CtrError as error:
            self.kill(str(error))
        except Exception as error:  # catch everything, because nothing else would stop the stages
            traceback.print_exc()
            self.kill(
                f"the station process failed while it served the control process ({type(error).__name__}: {error})"
            )
        with self._answered:  # wake every thread that waits for an answer
            self._ended = True
            self._answered.notify_all()
        if self._fallback is not None and self._driven:
            self._attempt = self._fallback.begin()
        try:
            if not self._closing:
                killed, details = self._killed
                how = killed or f"the control process ended {self._child.ended(self._clock.real(REPLY_TIMEOUT_S))}"
                self._child.kill()  # threads of a custom driver may keep it alive
                self._on_exit(ExitReport(how, "" if self._attempt is None else "the stages are being stopped", details))
        finally:
            self._over.set()
        if self._attempt is not None and self._fallback is not None:
            so_far = self._fallback.outcome(self._attempt, STOP_REPLY_TIMEOUT_S)
            if not self._attempt.done():
                self._report_stop(so_far)
            self._attempt.add_done_callback(lambda attempt: self._report_stop(attempt.result()))

    def _report_stop(self, stopped: StopOutcome) -> None:
        """Report the outcome, unless this host is closed: another control process may then drive the stages."""
        if self._closing:
            return
        if stopped.confirmed and self._ring.counters[DRIVER] == self.pid:
            self._ring.counters[DRIVER] = 0
        self._on_report(stopped)

    def _listen(self) -> None:
        self._opened = devices = self._registered(self._devices())
        self._fallback = FallbackStop(devices.stages, self._robot, self._clock, fifo=self._fifo)
        brief(self._ring, devices, self._robot)
        try:
            with self._sending:
                self._child.pipe.send(devices)
            while True:
                message = self._child.pipe.recv()
                try:
                    self._take(message)
                except Exception:  # a message that fails must not prevent the next one
                    traceback.print_exc()
        except (EOFError, OSError):
            return  # the control process has ended

    def _take(self, message: Reply | ControlReport) -> None:
        if not isinstance(message, Reply):
            self._on_report(message)
            return
        with self._answered:
            if message.number in self._waiting:
                self._replies[message.number] = message.refused
                self._answered.notify_all()
