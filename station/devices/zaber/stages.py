"""Driver of Zaber T-series stages for the control loop: on one chain, or with a separate port for each stage.

Connecting and homing are sequences of requests, which `poll` advances. Events on the serial lines determine the
`condition` of the stages, and `problem` states the reason for a FAULT as text.
"""

import contextlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import JointFile, RobotFile
from station.config.strict import ConfigError, check
from station.devices.config import in_order
from station.devices.interfaces import Condition, DeviceFault, JointReading, Severity
from station.devices.links.link import LinkError, SerialLink, reopen
from station.devices.zaber.chain import MAX_MISSES, Axis, LineCounts, LineSettings, ZaberChain
from station.devices.zaber.protocol import (
    BAUD,
    FIRST_ALIAS,
    SPEED_UNIT,
    Happening,
    Reply,
    ReplyLost,
    Request,
    UnexpectedMotion,
    UnsolicitedError,
    ZaberError,
    alias_number,
    error_text,
)
from station.devices.zaber.sequences import Script, Sequences, Units
from station.devices.zaber.setup import PortSetup, StageFile, StageSetup, ZaberFile


class ZaberStages:
    """`Stages` of Zaber units. `poll`, `command` and `stop` never raise: `condition` and `problem` report faults."""

    def __init__(
        self,
        setups: Sequence[StageSetup],
        ports: Sequence[PortSetup],
        line: LineSettings | None = None,
    ) -> None:
        self._units = Units(setups)
        self._sequences = Sequences(self._units)
        self.setups = self._units.setups
        self.homed = self._units.homed  #: whether each stage is homed
        self.identities = self._units.identities  #: identity that each unit has reported; None before it has
        self.condition = Condition.CLOSED
        self.problem = ""  #: why the condition is FAULT
        self._details = ""  # address and raw error that belong to `problem`
        self.complaints: list[str] = []  #: the last ten errors that units reported without a request
        self._line = line or LineSettings()
        self._scale = [SPEED_UNIT * setup.step for setup in setups]
        self._sent = np.zeros(len(setups))  # velocities sent (n,) [rad/s or m/s]
        self._script: Script | None = None
        self._wait_until = -math.inf
        self._send_deferred = False
        self._pending_velocities: list[float] = []  # velocities that wait for a free line [rad/s or m/s]
        self._all_known = False  # whether at the last poll every stage was homed and had a known position
        self._use(ports)

    # The control loop's side

    def poll(self, now: float) -> JointReading:
        """Return positions at `now` [s], NaN for a stage that has never answered, and advance all sequences."""
        self._sequences.now = now
        for which, chain in enumerate(self._units.chains):
            for event in chain.feed(self._read(which), now):
                self._process(which, event)
        if self._script is not None and now >= self._wait_until and not self._asking:
            self._advance(None)
        if self._send_deferred:
            self._send_deferred = False  # `command` follows in the same tick with newer velocities, and sends them
        else:
            self._send(now)
        self._all_known = all([estimate.known for _, _, estimate in self._counted]) and all(self.homed)  # noqa: C419
        positions = [zero + step * estimate.position for zero, step, estimate in self._counted]
        return JointReading(np.array(positions), self._sent)

    def command(self, velocities: Array, now: float) -> None:
        """Set joint velocities (n,) [rad/s or m/s]; a non-finite one stops all axes. Does nothing unless `ready`."""
        if not self.ready:
            return
        requested: list[float] = velocities.tolist()
        if not all(map(math.isfinite, requested)):
            self.stop(now)
            return
        self._pending_velocities, self._send_deferred = requested, True
        self._send(now)

    def stop(self, now: float) -> None:
        """Stop every axis that can be reached, before any other message; abort connecting and homing."""
        if self._script is not None:
            self._end_script()
            self._fail("stopped while connecting" if self.condition is Condition.CONNECTING else "")
        self._pending_velocities = []
        for chain in self._units.chains:
            chain.stop()
        self._send(now)

    # The station's side

    @property
    def ready(self) -> bool:
        """Whether the stages are connected and homed, and every position is known."""
        return self._all_known and self.condition is Condition.CONNECTED

    @property
    def ports(self) -> tuple[PortSetup, ...]:
        """The serial ports in use."""
        return self._units.ports

    @property
    def at_rest(self) -> bool:
        """Whether every axis that was commanded to stop has confirmed its stop."""
        return not any(chain.stopping for chain in self._units.chains)

    @property
    def counts(self) -> list[LineCounts]:
        """Message counters of each axis."""
        return [chain.counts[axis] for chain, axis in self._units.where]

    @property
    def lost_bytes(self) -> int:
        """Number of received bytes that belong to no message."""
        return sum(chain.parser.dropped for chain in self._units.chains)

    def connect(self, now: float, ports: Sequence[PortSetup] | None = None) -> None:
        """Identify and set up every unit; `ports` replaces lost ports. Later calls accept only the same units."""
        if ports is None and self._broken:
            try:
                for port in self.ports:
                    reopen(port.link)
            except LinkError as error:
                self.condition, self.problem = Condition.FAULT, "the stages' port cannot be opened again"
                self._details = str(error)
                return
        if ports is not None or self.condition is not Condition.CLOSED:
            self._use(ports or self.ports)
        self._sequences.now, self.condition = now, Condition.CONNECTING
        self.problem = self._details = ""
        self._start_script(self._sequences.connect())

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - the state is that of the last poll
        """Return a FAULT with its cause; `details` contains unsolicited errors of the units."""
        if self.condition is not Condition.FAULT:
            return None
        units = self._units
        named = [units.address(i) for i in range(len(units.setups)) if re.search(rf"{units.name(i)}\b", self.problem)]
        return DeviceFault(Severity.FAULT, self.problem, "; ".join(filter(None, (*named, self._details))))

    def details(self) -> Mapping[str, Any]:
        """Return identity, port and message counters of the units, and the progress of homing."""
        homing = self._sequences.homing if self.condition is Condition.HOMING else None
        return (
            ({} if homing is None else {"homing": homing.progress(self._sequences.now)})
            | {
                setup.joint.name: {
                    "device": setup.device,
                    "port": next(port.link.name for port in self.ports if i in port.stages),
                    "identity": None if identity is None else identity._asdict(),
                    "homed": homed,
                    **vars(counts),
                }
                for i, (setup, identity, homed, counts) in enumerate(
                    zip(self.setups, self.identities, self.homed, self.counts, strict=True)
                )
            }
            | {"lost_bytes": self.lost_bytes, "complaints": list(self.complaints)}
        )

    def home(self, now: float) -> None:
        """Home every stage: the translations first, then one rotation after the other.

        Before the call the operator must have confirmed that the stages can move freely.

        Raises:
            ZaberError: the stages are not connected, or a sequence is running.
        """
        if self.condition is not Condition.CONNECTED:
            raise ZaberError(f"the stages cannot be homed while they are {self.condition.value}; connect them first")
        self._sequences.now, self.condition = now, Condition.HOMING
        self._start_script(self._sequences.home())

    def close(self) -> None:
        """Close the ports."""
        self._end_script()
        self.condition = Condition.CLOSED
        for port in self.ports:
            port.link.close()

    # Sequences and events

    def _use(self, ports: Sequence[PortSetup]) -> None:
        """Start a new session of all stages on these ports."""
        indices = sorted(i for port in ports for i in port.stages)
        if indices != list(range(len(self.setups))):
            raise ZaberError(f"ports have the stages {indices}; each of 0 ... {len(self.setups) - 1} is needed once")
        self._units.ports = tuple(ports)
        self._end_script()
        self._broken: set[int] = set()
        self._units.chains = []
        where: dict[int, tuple[ZaberChain, int]] = {}
        for port in self.ports:
            setups = [self.setups[i] for i in port.stages]
            axes = [Axis(s.device, s.top, s.acceleration, s.maximum, alias_number(k)) for k, s in enumerate(setups)]
            if len({axis.device for axis in axes}) < len(axes):
                raise ZaberError(f"two stages on {port.link.name} have the same device number; renumber the chain")
            if any(axis.device >= FIRST_ALIAS for axis in axes):
                raise ZaberError(
                    f"a stage on {port.link.name} has a device number beyond {FIRST_ALIAS - 1}; from {FIRST_ALIAS} on "
                    "numbers are used as aliases: renumber the chain"
                )
            chain = ZaberChain(axes, self._line)
            self._units.chains.append(chain)
            where |= {i: (chain, k) for k, i in enumerate(port.stages)}
        self._units.where = [where[i] for i in range(len(self.setups))]
        self._update_sent()
        self._counted = [(s.position(0), s.step, self._units.estimate(i)) for i, s in enumerate(self.setups)]

    def _start_script(self, script: Script) -> None:
        self._end_script()
        self._script, self._wait_until = script, -math.inf
        self._advance(None)

    def _advance(self, answer: Reply | None) -> None:
        """Pass a reply, or None after a wait, to the running sequence and execute its next step."""
        if self._script is None:
            return
        self._asking = False
        try:
            step = self._script.send(answer)
        except StopIteration:
            self._script = None
            self.condition = Condition.CONNECTED
        except ZaberError as error:
            self._script = None
            self._fail(str(error))
        else:
            if isinstance(step, Request):
                chain, axis = self._units.where[step.axis]
                self._asking = True
                chain.send_request(step._replace(axis=axis))
            else:
                self._wait_until = self._sequences.now + step

    def _end_script(self) -> None:
        if self._script is not None:
            self._script.close()
            for chain in self._units.chains:
                chain.cancel()
        self._script, self._asking = None, False

    def _fail(self, why: str) -> None:
        """Stop every axis and enter FAULT with the first reason; an empty `why` returns to CONNECTED instead."""
        if not why:
            self.condition = Condition.CONNECTED
            for i in range(len(self.setups)):
                self._units.estimate(i).adrift = False
            return
        self._pending_velocities = []
        if self.condition is not Condition.FAULT:
            self.condition, self.problem = Condition.FAULT, why
        for chain in self._units.chains:
            chain.stop()

    def _process(self, which: int, event: Happening) -> None:
        if isinstance(event, Reply):
            self._advance(event)
            return
        i = self.ports[which].stages[event.axis]
        if isinstance(event, ReplyLost):
            self._lose((i,), f"{MAX_MISSES} replies of a unit are missing")
        elif isinstance(event, UnexpectedMotion):
            self._end_script()
            self.homed[i] = False
            self._units.home_again.add(i)
            self._fail(f"{self._units.name(i)} does not move as commanded; was it reset, or moved by another program?")
        elif isinstance(event, UnsolicitedError):
            self.complaints = [*self.complaints[-9:], f"{self._units.name(i)}: {error_text(event.code)}"]
        else:
            self.homed[i] = False
            self._units.home_again.add(i)
            self._units.estimate(i).forget()

    def _lose(self, stages: Sequence[int], why: str) -> None:
        """Handle lost stages: stop all others, and report how far each lost stage can still move."""
        self._end_script()
        self._units.home_again |= set(stages)
        texts = [f"{self._units.name(i)} cannot be reached; {self._units.reach(i)}" for i in stages]
        for i in stages:
            self.homed[i] = False
        self._details = "; ".join(dict.fromkeys(filter(None, (self._details, why))))
        if self.condition is Condition.FAULT:
            self.problem = "; ".join([self.problem, *texts])
        self._fail("; ".join(texts))

    # Links

    def _read(self, which: int) -> bytes:
        if which in self._broken:
            return b""
        try:
            return self._units.ports[which].link.read()
        except LinkError as error:
            self._break(which, error)
            return b""

    def _send(self, now: float) -> None:
        if self.condition is Condition.CLOSED:
            return
        for which, chain in enumerate(self._units.chains):
            if which in self._broken or not chain.is_free(now):
                continue
            if self._pending_velocities:
                # Convert only when the line is free, because it is busy in most ticks.
                for (on, axis), velocity, scale in zip(
                    self._units.where, self._pending_velocities, self._scale, strict=True
                ):
                    on.command(axis, round(velocity / scale))
                self._pending_velocities = []
            if data := chain.due(now):
                self._update_sent()
                try:
                    self._units.ports[which].link.write(data)
                except LinkError as error:
                    self._break(which, error)

    def _update_sent(self) -> None:
        """Convert the speeds sent to the axes; only sent bytes change them, so most ticks need no conversion."""
        self._sent = np.array(self._scale) * [chain.sent[axis] for chain, axis in self._units.where]

    def _break(self, which: int, error: LinkError) -> None:
        """Handle a lost link: all stages on it are lost."""
        self._broken.add(which)
        chain = self._units.chains[which]
        chain.lost |= set(range(len(chain.axes)))
        chain.stopping.clear()
        self._lose(self.ports[which].stages, str(error))


def zaber(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], ZaberStages]:
    """Return the opener of Zaber T-series stages; raises ConfigError."""
    key = "devices.stages"
    file = check(ZaberFile, options, key)
    if file.joints:
        stages = in_order(file.joints, [joint.name for joint in robot.joints], f"{key}.joints")
    else:
        stages = [StageFile(device=number) for number, _ in enumerate(robot.joints, 1)]
    lines: dict[str, list[int]] = {}
    for i, (joint, stage) in enumerate(zip(robot.joints, stages, strict=True)):
        port = stage.port or file.port
        if port is None:
            raise ConfigError(f"{key}.port is missing: {joint.name} has no port, and the chain has none")
        others = lines.setdefault(port, [])
        twin = next((k for k in others if stages[k].device == stage.device), None)
        if twin is not None:
            raise ConfigError(
                f"{key}.joints.{joint.name}.device = {stage.device}: {robot.joints[twin].name} has the same number on "
                f"{port}; give each unit of a chain a different number"
            )
        others.append(i)
    setups = [_setup(joint, stage, f"{key}.joints") for joint, stage in zip(robot.joints, stages, strict=True)]

    def opener() -> ZaberStages:
        with contextlib.ExitStack() as opened:
            ports: list[PortSetup] = []
            for url, indices in lines.items():
                link = SerialLink(url, BAUD)
                opened.callback(link.close)
                ports.append(PortSetup(link, tuple(indices)))
            stages = ZaberStages(setups, ports, LineSettings(deadline=file.deadline))
            opened.pop_all()
            return stages

    return opener


def _setup(joint: JointFile, stage: StageFile, key: str) -> StageSetup:
    try:
        setup = StageSetup.of(joint, stage.device, stage.home_at, stage.backwards)
        speed = setup.home_speed if stage.home_speed is None else stage.home_speed
        return replace(setup, home_speed=speed, device_id=stage.device_id, serial=stage.serial)
    except CtrError as error:
        raise ConfigError(f"{key}.{error}") from None
