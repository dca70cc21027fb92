"""Driver of stages on one line for the control loop: connecting, homing, velocities, stop and faults.

The protocol is in two parts: a `Line` schedules the messages of all axes and processes their replies, and
`AxesOnLine` knows the setups and the sequences of the protocol.
"""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import JointFile
from station.devices.interfaces import Condition, DeviceFault, JointReading, Severity
from station.devices.links.link import Link, LinkError, reopen
from station.devices.reach import reach
from station.devices.sequence import SequenceRunner
from station.devices.zaber.estimate import AxisEstimate
from station.devices.zaber.sequences import Homing

Request = TypeVar("Request")
Answer = TypeVar("Answer")
RequestIn = TypeVar("RequestIn", contravariant=True)
AnswerIn = TypeVar("AnswerIn", contravariant=True)


class AxisLost(NamedTuple):
    """Event: an axis no longer answers."""

    axis: int
    why: str


class AxisFault(NamedTuple):
    """Event: an axis cannot go on; `must_home`: its position is lost."""

    axis: int
    text: str
    must_home: bool = False


class LineFault(NamedTuple):
    """Event: the device of all axes cannot continue; `must_home`: it has lost their positions."""

    text: str
    must_home: bool


class StagesError(CtrError):
    """The stages cannot execute a command in their present condition."""


class Setup(Protocol):
    """Parameters of one stage that the driver needs."""

    @property
    def joint(self) -> JointFile:
        """The joint that the stage moves."""
        ...

    @property
    def minimum(self) -> int:
        """Lower limit of the travel [counts]."""
        ...

    @property
    def maximum(self) -> int:
        """Upper limit of the travel [counts]."""
        ...

    @property
    def speed_scale(self) -> float:
        """Data of a velocity command per joint velocity [data per rad/s or m/s]."""
        ...

    def position(self, counts: float, /) -> float:
        """Return the joint position at a count of the axis [rad or m]."""
        ...


class Line(Protocol[RequestIn]):
    """The axes on one line: sends their messages and processes their replies, without I/O."""

    @property
    def estimates(self) -> Sequence[AxisEstimate]:
        """Estimated positions, counted from each axis's minimum [counts]."""
        ...

    @property
    def sent(self) -> Sequence[int]:
        """Last velocity sent to each axis [data of a velocity command]."""
        ...

    @property
    def lost(self) -> set[int]:
        """Axes that no longer answer."""
        ...

    def command(self, axis: int, speed: int) -> None:
        """Set the velocity of an axis [data of a velocity command]; only the latest velocity is sent."""
        ...

    def stop(self) -> None:
        """Stop all axes before any other command, until each axis has confirmed its stop."""
        ...

    def send_request(self, request: RequestIn) -> None:
        """Send one request; `feed` returns its answer."""
        ...

    def cancel(self) -> None:
        """Cancel the pending request."""
        ...

    def give_up(self) -> None:
        """Count every axis as lost, because the port is lost."""
        ...

    def feed(self, data: bytes, now: float) -> Sequence[Any]:
        """Process bytes that have arrived by `now` [s]; return answers and events, such as `AxisLost`."""
        ...

    def is_free(self, now: float) -> bool:
        """Return whether the line can transmit a command at `now` [s]."""
        ...

    def due(self, now: float) -> bytes:
        """Return the bytes to send at `now` [s]."""
        ...


class AxesOnLine(Protocol[Request, AnswerIn]):
    """State of the axes of one protocol; identities and homing states persist when the port is opened again."""

    now: float  #: time [s], set by the driver before it runs a sequence
    homed: list[bool]
    home_again: set[int]  #: axes that must be homed even if they report to be homed

    @property
    def line(self) -> Line[Request]:
        """The line's messages; `reset` replaces it."""
        ...

    @property
    def setups(self) -> Sequence[Setup]:
        """Parameters of the stages in the order of the robot's joints."""
        ...

    @property
    def homing(self) -> Homing | None:
        """Progress of the latest homing."""
        ...

    def reset(self) -> None:
        """Start a new session on the line."""
        ...

    def connect(self) -> Generator[Request | float, AnswerIn | None, None]:
        """Identify and set up every axis, then wait for the positions of all homed axes."""
        ...

    def home(self) -> Generator[Request | float, AnswerIn | None, None]:
        """Home every axis: the translations first, then one rotation after the other."""
        ...

    def fault(self, event: object, connected: bool) -> AxisFault | None:
        """Return the fault that an event of the line means; `connected`: no sequence is running."""
        ...

    def warning(self, i: int) -> str:
        """Return an axis's warning as text; empty without one."""
        ...

    def address(self, i: int) -> str:
        """Return the number of an axis on its line, for the details of messages."""
        ...

    def details(self, i: int) -> Mapping[str, Any]:
        """Return identity and counters of an axis."""
        ...


class StagesOnLine(Generic[Request, Answer]):
    """`Stages` on one line. `poll`, `command` and `stop` never raise: `trouble` reports faults."""

    def __init__(
        self,
        state: AxesOnLine[Request, Answer],
        link: Link,
        answer: type[Answer],
        brakes_within: float | None = None,
    ) -> None:
        """Create the driver.

        Args:
            state: state of the axes.
            link: the line's port.
            answer: type of the line's events that answer a request.
            brakes_within: time after which an axis brakes by itself without commands [s]; None: it does not.
        """
        self.condition, self._brakes_within = Condition.CLOSED, brakes_within
        self._link, self._state, self._answer = link, state, answer
        self._runner = SequenceRunner[Request, Answer]()
        self._problem = self._details = ""  # why the condition is FAULT; raw values that belong to it
        self._broken = False  # whether the port is lost
        self._explained = False  # whether `_problem` contains the fault of a whole line
        self._velocities: list[float] = []  # velocities that wait for a free line [rad/s or m/s]
        self._send_deferred = False
        self._scales = np.array([setup.speed_scale for setup in state.setups])

    # The control loop's side

    @property
    def ready(self) -> bool:
        """Whether the stages are connected and homed, and every position is known."""
        return (
            self.condition is Condition.CONNECTED
            and all(self._state.homed)
            and all([estimate.known for estimate in self._line.estimates])  # noqa: C419 - at every tick
        )

    def poll(self, now: float) -> JointReading:
        """Return positions at `now` [s], NaN for a stage that has never answered, and advance all sequences."""
        state = self._state
        state.now = now
        for event in self._line.feed(self._read(), now):
            self._process(event, now)
        self._advance(now)
        if self._send_deferred:
            self._send_deferred = False  # `command` follows in the same tick with newer velocities, and sends them
        else:
            self._send(now)
        estimates = self._line.estimates
        positions = [s.position(e.position + s.minimum) for s, e in zip(state.setups, estimates, strict=True)]
        return JointReading(np.array(positions), self._line.sent / self._scales)

    def command(self, velocities: Array, now: float) -> None:
        """Set joint velocities (n,) [rad/s or m/s]; a non-finite one stops all axes. Does nothing unless `ready`."""
        if not self.ready:
            return
        requested: list[float] = velocities.tolist()
        if not all(map(math.isfinite, requested)):
            self.stop(now)
            return
        self._velocities, self._send_deferred = requested, True
        self._send(now)

    def stop(self, now: float) -> None:
        """Stop every axis that can be reached, before any other command; abort connecting and homing."""
        if self._runner.running:
            self._end_sequence()
            if self.condition is Condition.CONNECTING:
                self._fail("stopped while connecting")
            else:
                self.condition = Condition.CONNECTED
                for estimate in self._line.estimates:
                    estimate.adrift = False
        self._velocities = []
        self._line.stop()
        self._send(now)

    # The station's side

    def connect(self, now: float) -> None:
        """Identify and set up every stage; after a FAULT open a lost port again. Later calls accept the same devices.

        A new session starts, and every axis stops.
        """
        if self._broken:
            try:
                reopen(self._link)
            except LinkError as error:
                self.condition, self._details = Condition.FAULT, str(error)
                self._problem = "the stages' port cannot be opened again"
                return
        self._broken = self._explained = False
        self._state.reset()
        self._line.stop()
        self._velocities, self._problem, self._details = [], "", ""
        self._state.now, self.condition = now, Condition.CONNECTING
        self._runner.start(self._state.connect(), now)
        self._advance(now)

    def home(self, now: float) -> None:
        """Home every stage: the translations first, then one rotation after the other.

        Before the call the operator must have confirmed that the stages can move freely.

        Raises:
            StagesError: the stages are not connected, or a sequence is running.
        """
        if self.condition is not Condition.CONNECTED:
            raise StagesError(f"the stages cannot be homed while they are {self.condition.value}")
        self._state.now, self.condition = now, Condition.HOMING
        self._runner.start(self._state.home(), now)
        self._advance(now)

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - the state is that of the last poll
        """Return a FAULT with its cause, or the warning of the first stage that has one."""
        if self.condition is Condition.FAULT:
            return DeviceFault(Severity.FAULT, self._problem, self._details)
        for i, _ in enumerate(self._state.setups):
            if warning := self._state.warning(i):
                return DeviceFault(Severity.WARN, f"{self._name(i)}: {warning}", self._address(i))
        return None

    def details(self) -> Mapping[str, Any]:
        """Return identity, port and counters of the stages, and the progress of homing."""
        state = self._state
        homing = state.homing if self.condition is Condition.HOMING else None
        return ({} if homing is None else {"homing": homing.progress(state.now)}) | {
            setup.joint.name: {"port": self._link.name, "homed": state.homed[i], **state.details(i)}
            for i, setup in enumerate(state.setups)
        }

    def close(self) -> None:
        """Close the port."""
        self._end_sequence()
        self.condition = Condition.CLOSED
        self._link.close()

    # Sequences and events

    @property
    def _line(self) -> Line[Request]:
        return self._state.line

    def _advance(self, now: float, answer: Answer | None = None) -> None:
        """Continue the running sequence, and process its end."""
        if not self._runner.running:
            return
        request = self._runner.advance(now, answer)
        if request is not None:
            self._line.send_request(request)
        elif not self._runner.running:
            if self._runner.failure:
                self._fail(self._runner.failure)
            else:
                self.condition = Condition.CONNECTED

    def _end_sequence(self) -> None:
        self._runner.end()
        self._line.cancel()

    def _process(self, event: object, now: float) -> None:
        if isinstance(event, self._answer):
            self._advance(now, event)
        elif isinstance(event, AxisLost):
            self._lose((event.axis,), event.why)
        elif isinstance(event, LineFault):
            if event.must_home:
                for i in range(len(self._state.setups)):
                    self._must_home(i)
            if self.condition is Condition.FAULT and not self._explained:
                self._problem = f"{event.text}; {self._problem}"  # it explains an earlier silence
            self._explained, self._details = True, self._details or self._link.name
            self._fail(event.text)
        elif fault := self._state.fault(event, self.condition is Condition.CONNECTED):
            if fault.must_home:
                self._must_home(fault.axis)
            self._fail(f"{self._name(fault.axis)} {fault.text}", fault.axis)

    def _must_home(self, i: int) -> None:
        self._state.homed[i] = False
        self._state.home_again.add(i)

    def _lose(self, stages: Sequence[int], why: str) -> None:
        """Handle lost stages: stop all others, and report how far each lost stage can still move."""
        state = self._state
        texts: list[str] = []
        for i in stages:
            setup, speed = state.setups[i], self._line.sent[i]
            end = setup.position(setup.maximum if speed > 0 else setup.minimum)
            last = setup.position(self._line.estimates[i].position + setup.minimum)
            text = reach(setup.joint, last, end, speed != 0, self._brakes_within)
            texts.append(f"{self._name(i)} cannot be reached; {text}")
            self._must_home(i)
        self._details = "; ".join(dict.fromkeys(filter(None, (self._details, *map(self._address, stages), why))))
        if self.condition is Condition.FAULT:
            self._problem = "; ".join([self._problem, *texts])
        self._fail("; ".join(texts))

    def _fail(self, why: str, stage: int | None = None) -> None:
        """Stop every axis and enter FAULT with the first reason."""
        self._end_sequence()
        self._velocities = []
        if self.condition is not Condition.FAULT:
            self.condition, self._problem = Condition.FAULT, why
            self._details = self._details if stage is None else self._address(stage)
        self._line.stop()

    def _name(self, i: int) -> str:
        return f"the stage {self._state.setups[i].joint.name}"

    def _address(self, i: int) -> str:
        return f"{self._state.setups[i].joint.name}: {self._state.address(i)} on {self._link.name}"

    # Link

    def _read(self) -> bytes:
        if self._broken:
            return b""
        try:
            return self._link.read()
        except LinkError as error:
            self._break(error)
            return b""

    def _send(self, now: float) -> None:
        line = self._line
        if self.condition is Condition.CLOSED or self._broken or not line.is_free(now):
            return
        if self._velocities:
            for i, velocity in enumerate(self._velocities):
                line.command(i, round(velocity * self._scales.item(i)))
            self._velocities = []
        if data := line.due(now):
            try:
                self._link.write(data)
            except LinkError as error:
                self._break(error)

    def _break(self, error: LinkError) -> None:
        """Handle a lost port: all its stages are lost."""
        self._broken = True
        stages = [i for i in range(len(self._state.setups)) if i not in self._line.lost]
        self._line.give_up()
        self._lose(stages, str(error))
