"""Driver of stages for the control loop: connecting, homing, velocities, stop and faults, on one line or several.

A protocol provides two parts. A `Line` schedules the messages of its axes and processes their replies. `StageProtocol`
creates the lines of a session, and has the scripts that connect and home the axes.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import JointFile
from station.devices.interfaces import Condition, DeviceFault, JointReading, Severity
from station.devices.kernel.axis import CountedJoint
from station.devices.kernel.line import AxisLost, Line, LineCounts, LineFault, RequestIn, TwoDevices, UnexpectedMotion
from station.devices.kernel.script import ScriptRunner
from station.devices.kernel.startup import Axes, Script
from station.devices.links.link import Link, LinkError, reopen

Request = TypeVar("Request")
Answer = TypeVar("Answer")


class AxisFault(NamedTuple):
    """Fault of an axis, which cannot continue; `must_home`: its position is lost."""

    text: str
    must_home: bool = False


class Port(NamedTuple):
    """A port and the stages on its line, as indices of joints."""

    link: Link
    stages: tuple[int, ...]


def one_port(link: Link, setups: Sequence[CountedJoint]) -> list[Port]:
    """Return the only port of stages that are all on one line."""
    return [Port(link, tuple(range(len(setups))))]


class StagesError(CtrError):
    """The stages cannot execute a command in their present condition."""


class StageProtocol(Protocol[RequestIn]):
    """Interface of the part of a stages' driver that depends on the protocol."""

    @property
    def axes(self) -> Axes[Any]:
        """The axes; their identities and homing states persist over sessions."""
        ...

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[Line[RequestIn]]:
        """Start a session with one new line for each port; `again`: not the first session, so all axes stop first."""
        ...

    def connect(self) -> Script:
        """Identify and set up every axis, then wait for the positions of all homed axes."""
        ...

    def home(self) -> Script:
        """Home every axis: the translations first, then one rotation after the other."""
        ...

    def happened(self, i: int, event: Any, connected: bool) -> AxisFault | None:
        """Process an event of axis `i`, and return the fault that it means; `connected`: no script is running."""
        ...

    def warning(self, i: int) -> str:
        """Return an axis's warning as text; empty without one."""
        ...

    def address(self, i: int) -> str:
        """Return the number of an axis on its line, for the details of messages."""
        ...

    def details(self, i: int) -> Mapping[str, Any]:
        """Return further data that an axis reports, in addition to its identity and its counters."""
        ...


class LineStages(Generic[Request, Answer]):
    """Driver of stages on one or several lines. `poll`, `command` and `stop` never raise: `trouble` reports faults."""

    def __init__(
        self,
        protocol: StageProtocol[Request],
        ports: Sequence[Port],
        answer: type[Answer],
        brakes_within: float | None = None,
    ) -> None:
        """Create the driver.

        Args:
            protocol: the protocol of the stages.
            ports: the ports of the lines, and the stages on each.
            answer: type of the lines' events that answer a request.
            brakes_within: time after which an axis brakes by itself without commands [s]; None: it does not.

        Raises:
            StagesError: a stage is on no port or on several.
        """
        self.condition = Condition.CLOSED
        self.problem = ""  #: why the condition is FAULT
        self.axes = protocol.axes
        self._protocol, self._answer, self._brakes_within = protocol, answer, brakes_within
        self._runner = ScriptRunner[Request, Answer]()
        self._details = ""  # raw values that belong to the problem
        self._explained = False  # whether `problem` contains the fault of a whole line
        self._velocities: list[float] = []  # velocities that wait for a free line [rad/s or m/s]
        self._send_deferred = self._all_known = False
        self._steps = np.array([setup.velocity_step for setup in self.axes.setups])
        self._use(ports, again=False)

    # Methods that the control loop calls in each tick, or to stop the stages

    @property
    def ready(self) -> bool:
        """Whether the stages are connected and homed, and every position is known."""
        return self._all_known and self.condition is Condition.CONNECTED

    def poll(self, now: float) -> JointReading:
        """Return positions at `now` [s], NaN for a stage that has never answered, and advance all scripts."""
        self.axes.now = now
        for which, line in enumerate(self.lines):
            for event in line.feed(self._read(which), now):
                self._process(which, event)
        self._advance()
        if self._send_deferred:
            self._send_deferred = False  # `command` follows in the same tick with newer velocities, and sends them
        else:
            self._send(now)
        self._all_known = all([estimate.known for _, _, estimate in self._counted]) and all(self.axes.homed)  # noqa: C419
        positions = [zero + step * estimate.position for zero, step, estimate in self._counted]
        return JointReading(np.array(positions), self._steps * [line.axes.sent[axis] for line, axis in self._where])

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
            self._end_script()
            if self.condition is Condition.CONNECTING:
                self._fail("stopped while connecting")
            else:
                self.condition = Condition.CONNECTED
                for estimate in self.axes.estimates:
                    estimate.adrift = False
        self._velocities = []
        self._stop_lines()
        self._send(now)

    # Other methods for the station

    @property
    def at_rest(self) -> bool:
        """Whether every axis that was commanded to stop has confirmed its stop."""
        return not any(line.axes.stopping for line in self.lines)

    @property
    def counts(self) -> list[LineCounts]:
        """Message counters of each axis."""
        return [line.axes.counts[axis] for line, axis in self._where]

    def connect(self, now: float, ports: Sequence[Port] | None = None) -> None:
        """Identify and set up every stage; `ports` replaces lost ports. Later calls accept only the same devices.

        A lost port is opened again. Later calls stop every axis first, because axes may still move after a lost line.
        """
        if ports is None and self._broken:
            try:
                for which in sorted(self._broken):
                    reopen(self.ports[which].link)
            except LinkError as error:
                self.condition, self._details = Condition.FAULT, str(error)
                self.problem = "the stages' port cannot be opened again"
                return
        again = self.condition is not Condition.CLOSED
        self._use(ports or self.ports, again=again)
        self._velocities, self.problem, self._details = [], "", ""
        self.axes.now, self.condition = now, Condition.CONNECTING
        self.axes.started, self.axes.waits = now, ""
        self._runner.start(self._protocol.connect(), now)
        self._advance()

    def home(self, now: float) -> None:
        """Home every stage: the translations first, then one rotation after the other.

        Before the call the operator must have confirmed that the stages can move freely.

        Raises:
            StagesError: the stages are not connected, or a script is running.
        """
        if self.condition is not Condition.CONNECTED:
            raise StagesError(f"the stages cannot be homed while they are {self.condition.value}; connect them first")
        self.axes.now, self.condition = now, Condition.HOMING
        self._runner.start(self._protocol.home(), now)
        self._advance()

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - the state is that of the last poll
        """Return a FAULT with its cause, or the warning of the first stage that has one."""
        if self.condition is Condition.FAULT:
            return DeviceFault(Severity.FAULT, self.problem, self._details)
        if self.axes.waits and self.condition is Condition.CONNECTING:
            return DeviceFault(Severity.WARN, self.axes.waits)
        for i, _ in enumerate(self.axes.setups):
            if warning := self._protocol.warning(i):
                return DeviceFault(Severity.WARN, f"{self.axes.name(i)}: {warning}", self._address(i))
        return None

    def details(self) -> Mapping[str, Any]:
        """Return identity, port and counters of the stages, and the progress of homing."""
        axes = self.axes
        homing = axes.homing if self.condition is Condition.HOMING else None
        return ({} if homing is None else {"homing": homing.progress(axes.now)}) | {
            setup.joint.name: {
                "port": self._link_name(i),
                "homed": axes.homed[i],
                "identity": None if (identity := axes.identities[i]) is None else identity._asdict(),
                **self._protocol.details(i),
                **vars(self.counts[i]),
                "settings": dict(axes.settings[i]),
            }
            for i, setup in enumerate(axes.setups)
        }

    def close(self) -> None:
        """Close the ports."""
        self._end_script()
        self.condition = Condition.CLOSED
        for port in self.ports:
            port.link.close()

    # Scripts and events

    def _use(self, ports: Sequence[Port], *, again: bool) -> None:
        """Start a new session of all stages on these ports."""
        indices, setups = sorted(i for port in ports for i in port.stages), self.axes.setups
        if indices != list(range(len(setups))):
            raise StagesError(f"ports have the stages {indices}; each of 0 ... {len(setups) - 1} is needed once")
        self._runner.end()
        self.ports, self._broken, self._explained = tuple(ports), set[int](), False
        self.lines = tuple(self._protocol.session(ports, again=again))
        where = {i: (line, k) for line, port in zip(self.lines, ports, strict=True) for k, i in enumerate(port.stages)}
        self._where = [where[i] for i in range(len(setups))]
        self.axes.estimates = [line.axes.estimates[axis] for line, axis in self._where]
        starts = [setup.position(setup.minimum) for setup in setups]
        self._counted = list(zip(starts, [setup.step for setup in setups], self.axes.estimates, strict=True))

    def _advance(self, answer: Answer | None = None) -> None:
        """Continue the running script, and set the condition when it ends."""
        if not self._runner.running:
            return
        request: Any = self._runner.advance(self.axes.now, answer)
        if request is not None:
            if len(self.lines) == 1:
                self.lines[0].send_request(request)
            else:
                line, axis = self._where[request.axis]
                line.send_request(request._replace(axis=axis))
        elif not self._runner.running:
            if self._runner.failure:
                self._fail(self._runner.failure)
            else:
                self.condition = Condition.CONNECTED

    def _end_script(self) -> None:
        self._runner.end()
        self._all_known = False  # until the next poll, because the script may have changed it
        for line in self.lines:
            line.cancel()

    def _process(self, which: int, event: Any) -> None:
        if isinstance(event, self._answer):
            self._advance(event)
        elif isinstance(event, AxisLost):
            self._lose((self.ports[which].stages[event.axis],), event.why)
        elif isinstance(event, UnexpectedMotion):
            i = self.ports[which].stages[event.axis]
            self.axes.must_home(i)
            self._fail(f"{self.axes.name(i)} {event.why}", i)
        elif isinstance(event, TwoDevices):
            i = self.ports[which].stages[event.axis]
            self._fail(
                f"two devices answer as {self._protocol.address(i)}, with {event.what} {event.values[0]} and"
                f" {event.values[1]}: give one of them another number ({self.axes.name(i)})",
                i,
            )
        elif isinstance(event, LineFault):
            if event.must_home:
                for i in self.ports[which].stages:
                    self.axes.must_home(i)
            if self.condition is Condition.FAULT and not self._explained:
                self.problem = f"{event.text}; {self.problem}"  # it explains an earlier silence
            self._explained, self._details = True, self._details or self.ports[which].link.name
            self._fail(event.text)
        else:
            i = self.ports[which].stages[event.axis]
            if fault := self._protocol.happened(i, event, self.condition is Condition.CONNECTED):
                if fault.must_home:
                    self.axes.must_home(i)
                self._fail(f"{self.axes.name(i)} {fault.text}", i)

    def _lose(self, stages: Sequence[int], why: str) -> None:
        """Handle lost stages: stop all others, and report how far each lost stage can still move."""
        texts: list[str] = []
        for i in stages:
            setup, (line, axis) = self.axes.setups[i], self._where[i]
            # The last speed may have been lost with the line, so the stage may still have the speed before.
            speeds = {speed for speed in (line.axes.sent[axis], line.axes.answered[axis]) if speed}
            ends = {setup.position(setup.maximum if speed > 0 else setup.minimum) for speed in speeds}
            last = setup.position(self.axes.count(i))
            text = reach(setup.joint, last, sorted(ends), self._brakes_within)
            texts.append(f"{self.axes.name(i)} cannot be reached; {text}")
            self.axes.must_home(i)
        self._details = "; ".join(dict.fromkeys(filter(None, (self._details, *map(self._address, stages), why))))
        if self.condition is Condition.FAULT:
            self.problem = "; ".join([self.problem, *texts])
        self._fail("; ".join(texts))

    def _fail(self, why: str, stage: int | None = None) -> None:
        """Stop every axis and enter FAULT with the first reason."""
        self._end_script()
        self._velocities = []
        if self.condition is not Condition.FAULT:
            self.condition, self.problem = Condition.FAULT, why
            self._details = self._details if stage is None else self._address(stage)
        self._stop_lines()

    def _stop_lines(self) -> None:
        for line in self.lines:
            line.stop()

    def _link_name(self, i: int) -> str:
        return next(port.link.name for port in self.ports if i in port.stages)

    def _address(self, i: int) -> str:
        return f"{self.axes.setups[i].joint.name}: {self._protocol.address(i)} on {self._link_name(i)}"

    # Ports

    def _read(self, which: int) -> bytes:
        if which in self._broken:
            return b""
        try:
            return self.ports[which].link.read()
        except LinkError as error:
            self._break(which, error)
            return b""

    def _send(self, now: float) -> None:
        if self.condition is Condition.CLOSED:
            return
        for which, line in enumerate(self.lines):
            if which in self._broken or not line.is_free(now):
                continue
            if self._velocities:
                # Convert only when a line is free, because it is busy in most ticks.
                for (on, axis), velocity, step in zip(self._where, self._velocities, self._steps.tolist(), strict=True):
                    on.command(axis, round(velocity / step))
                self._velocities = []
            if data := line.due(now):
                try:
                    self.ports[which].link.write(data)
                except LinkError as error:
                    self._break(which, error)

    def _break(self, which: int, error: LinkError) -> None:
        """Handle a lost port: all its stages are lost."""
        self._broken.add(which)
        line, port = self.lines[which], self.ports[which]
        stages = [i for k, i in enumerate(port.stages) if k not in line.axes.lost]
        line.axes.give_up()
        self._lose(stages, str(error))


def reach(joint: JointFile, last: float, ends: Sequence[float], brakes_within: float | None = None) -> str:
    """Return the text about where a stage that no longer receives commands may move.

    Args:
        joint: the stage's joint.
        last: position when it was last measured [rad or m]; NaN: unknown.
        ends: hardware limits that it may move to [rad or m]; empty: the last command was no motion.
        brakes_within: time after which the stage brakes by itself without commands [s]; None: it does not.
    """
    if not ends and brakes_within is None:
        return "it was not moving"
    if not math.isfinite(last):
        return "its position was unknown"
    scale, unit = (180.0 / math.pi, "deg") if joint.motion == "rotation" else (1e3, "mm")
    seen = f"last seen at {scale * last:.1f} {unit}"
    if brakes_within is not None:
        return f"{seen}, it brakes by itself within {brakes_within:g} s"
    limits = " or to ".join(f"{scale * end:.1f} {unit}, {scale * abs(end - last):.1f} {unit} away" for end in ends)
    return f"{seen}, it can run on to {limits} (hardware limit)"
