"""Driver of Zaber stages with the ASCII protocol for the control loop: one chain of devices on one port."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError, check
from station.devices.config import in_order
from station.devices.interfaces import Condition, DeviceFault, JointReading, Severity
from station.devices.links.link import Link, LinkError, SerialLink, reopen
from station.devices.reach import reach
from station.devices.sequence import SequenceRunner
from station.devices.zaber_ascii.chain import (
    DEADLINE_S,
    MAX_MISSES,
    Answer,
    AsciiChain,
    AxisLost,
    Event,
    FlagChanged,
    Rejected,
    Request,
    UnexpectedMotion,
)
from station.devices.zaber_ascii.protocol import (
    BAUD,
    EXPECTED,
    FAULTS,
    NOT_HOMED,
    SPEED_FACTOR,
    ZaberAsciiError,
    flag_text,
    reason_text,
)
from station.devices.zaber_ascii.sequences import AsciiStagesState, Script
from station.devices.zaber_ascii.setup import AsciiFile, AsciiSetup, AsciiStageFile


class AsciiStages:
    """`Stages` of Zaber ASCII devices. `poll`, `command` and `stop` never raise: `trouble` reports faults."""

    def __init__(self, setups: Sequence[AsciiSetup], link: Link, deadline: float = DEADLINE_S) -> None:
        self.condition = Condition.CLOSED
        self._link, self._deadline = link, deadline
        self._state = AsciiStagesState(setups, self._new_chain(setups))
        self._runner = SequenceRunner[Request, Answer]()
        self._problem = self._details = ""  # why the condition is FAULT; raw values that belong to it
        self._broken = False  # whether the port is lost
        self._velocities: list[float] = []  # velocities that wait for a free line [rad/s or m/s]
        self._send_deferred = False
        self._steps = np.array([setup.step for setup in setups])

    # The control loop's side

    @property
    def ready(self) -> bool:
        """Whether the stages are connected and homed, and every position is known."""
        return (
            self.condition is Condition.CONNECTED
            and all(self._state.homed)
            and all([estimate.known for estimate in self._chain.estimates])  # noqa: C419 - at every tick
        )

    def poll(self, now: float) -> JointReading:
        """Return positions at `now` [s], NaN for a stage that has never answered, and advance all sequences."""
        state = self._state
        state.now = now
        for event in self._chain.feed(self._read(), now):
            self._process(event, now)
        self._advance(now)
        if self._send_deferred:
            self._send_deferred = False  # `command` follows in the same tick with newer velocities, and sends them
        else:
            self._send(now)
        positions = [setup.position(state.count(i)) for i, setup in enumerate(state.setups)]
        return JointReading(np.array(positions), self._steps * self._chain.sent / SPEED_FACTOR)

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
                for estimate in self._chain.estimates:
                    estimate.adrift = False
        self._velocities = []
        self._chain.stop()
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
        self._broken = False
        self._state.chain = self._new_chain(self._state.setups)
        self._state.chain.stop()
        self._velocities, self._problem, self._details = [], "", ""
        self._state.now, self.condition = now, Condition.CONNECTING
        self._start(self._state.connect(), now)

    def home(self, now: float) -> None:
        """Home every stage: the translations first, then one rotation after the other.

        Before the call the operator must have confirmed that the stages can move freely.

        Raises:
            ZaberAsciiError: the stages are not connected, or a sequence is running.
        """
        if self.condition is not Condition.CONNECTED:
            raise ZaberAsciiError(f"the stages cannot be homed while they are {self.condition.value}")
        self._state.now, self.condition = now, Condition.HOMING
        self._start(self._state.home(), now)

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - the state is that of the last poll
        """Return a FAULT with its cause, or the most severe warning flag of a stage."""
        if self.condition is Condition.FAULT:
            return DeviceFault(Severity.FAULT, self._problem, self._details)
        for i, flag in enumerate(self._chain.flags):
            if flag and flag not in EXPECTED and flag not in NOT_HOMED:
                return DeviceFault(Severity.WARN, f"{self._state.name(i)}: {flag_text(flag)}", self._address(i))
        return None

    def details(self) -> Mapping[str, Any]:
        """Return identity, port and counters of the stages, and the progress of homing."""
        state, chain = self._state, self._chain
        homing = state.homing if self.condition is Condition.HOMING else None
        return (
            ({} if homing is None else {"homing": homing.progress(state.now)})
            | {
                setup.joint.name: {
                    "device": setup.device,
                    "axis": setup.axis,
                    "port": self._link.name,
                    "identity": None if identity is None else identity._asdict(),
                    "homed": state.homed[i],
                    "flag": chain.flags[i],
                    **vars(chain.counts[i]),
                }
                for i, (setup, identity) in enumerate(zip(state.setups, state.identities, strict=True))
            }
            | {"lost_bytes": chain.reader.dropped}
        )

    def close(self) -> None:
        """Close the port."""
        self._end_sequence()
        self.condition = Condition.CLOSED
        self._link.close()

    # Sequences and events

    @property
    def _chain(self) -> AsciiChain:
        return self._state.chain

    def _new_chain(self, setups: Sequence[AsciiSetup]) -> AsciiChain:
        return AsciiChain([setup.on_chain() for setup in setups], self._deadline)

    def _start(self, script: Script, now: float) -> None:
        self._runner.start(script, now)
        self._advance(now)

    def _advance(self, now: float, answer: Answer | None = None) -> None:
        """Continue the running sequence, and process its end."""
        if not self._runner.running:
            return
        request = self._runner.advance(now, answer)
        if request is not None:
            self._chain.send_request(request)
        elif not self._runner.running:
            if self._runner.failure:
                self._fail(self._runner.failure)
            else:
                self.condition = Condition.CONNECTED

    def _end_sequence(self) -> None:
        self._runner.end()
        self._chain.cancel()

    def _process(self, event: Event, now: float) -> None:
        state = self._state
        if isinstance(event, Answer):
            self._advance(now, event)
            return
        i, name = event.axis, state.name(event.axis)
        if isinstance(event, AxisLost):
            self._lose((i,), f"{MAX_MISSES} replies of a device are missing")
        elif isinstance(event, UnexpectedMotion):
            self._must_home(i)
            self._fail(f"{name} does not move as commanded; was it reset, or moved by another program?", i)
        elif isinstance(event, Rejected):
            self._fail(f"{name} rejects its velocity: {reason_text(event.reason)}", i)
        elif isinstance(event, FlagChanged) and self.condition is Condition.CONNECTED:
            if event.flag in FAULTS:
                self._fail(f"{name}: {flag_text(event.flag)}", i)
            elif event.flag in NOT_HOMED and state.homed[i]:
                self._must_home(i)
                self._fail(f"{name} has lost its position; was it switched off and on? Home it again", i)

    def _must_home(self, i: int) -> None:
        self._state.homed[i] = False
        self._state.home_again.add(i)

    def _lose(self, stages: Sequence[int], why: str) -> None:
        """Handle lost stages: stop all others, and report how far each lost stage can still move."""
        state = self._state
        texts: list[str] = []
        for i in stages:
            setup, speed = state.setups[i], self._chain.sent[i]
            end = setup.position(setup.maximum if speed > 0 else setup.minimum)
            last = setup.position(state.count(i))
            texts.append(f"{state.name(i)} cannot be reached; {reach(setup.joint, last, end, speed != 0)}")
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
        self._chain.stop()

    def _address(self, i: int) -> str:
        setup = self._state.setups[i]
        return f"{setup.joint.name}: device {setup.device} axis {setup.axis} on {self._link.name}"

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
        chain = self._chain
        if self.condition is Condition.CLOSED or self._broken or not chain.is_free(now):
            return
        if self._velocities:
            for i, (velocity, step) in enumerate(zip(self._velocities, self._steps.tolist(), strict=True)):
                chain.command(i, round(velocity / step * SPEED_FACTOR))
            self._velocities = []
        if data := chain.due(now):
            try:
                self._link.write(data)
            except LinkError as error:
                self._break(error)

    def _break(self, error: LinkError) -> None:
        """Handle a lost port: all its stages are lost."""
        self._broken = True
        self._chain.stopping.clear()
        stages = [i for i in range(len(self._state.setups)) if i not in self._chain.lost]
        self._chain.lost |= set(stages)
        self._lose(stages, str(error))


def stage_files(file: AsciiFile, robot: RobotFile, key: str) -> list[AsciiStageFile]:
    """Return the axis of each joint; raises ConfigError."""
    names = [joint.name for joint in robot.joints]
    stages = (
        in_order(file.joints, names, f"{key}.joints")
        if file.joints
        else [AsciiStageFile(device=number) for number, _ in enumerate(names, 1)]
    )
    taken: dict[tuple[int, int], str] = {}
    for name, stage in zip(names, stages, strict=True):
        other = taken.setdefault((stage.device, stage.axis), name)
        if other != name:
            raise ConfigError(
                f"{key}.joints.{name}.device = {stage.device}: {other} has the same device and axis; "
                "give each device of a chain a different number"
            )
    return stages


def zaber_ascii(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], AsciiStages]:
    """Return the opener of Zaber stages with the ASCII protocol; raises ConfigError."""
    key = "devices.stages"
    file = check(AsciiFile, options, key)
    stages = stage_files(file, robot, key)
    try:
        setups = [AsciiSetup.of(joint, stage) for joint, stage in zip(robot.joints, stages, strict=True)]
    except CtrError as error:
        raise ConfigError(f"{key}.joints.{error}") from None
    return lambda: AsciiStages(setups, SerialLink(file.port, BAUD), file.deadline)
