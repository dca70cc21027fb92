"""Zaber T-series stages as the control loop's motors: one chain, or a port for each stage.

Connecting and homing are sequences, carried on by `poll`; what happens on the lines decides what the stages
are good for, and says so in words.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.devices.interfaces import Condition, JointReading, Severity, Trouble
from station.devices.links.link import LinkError
from station.devices.zaber.chain import Axis, Chain, Counts, Line
from station.devices.zaber.dialogue import Answer, Ask, Complaint, Happening, Lost, UnexpectedMotion
from station.devices.zaber.protocol import SPEED_UNIT, ZaberError, error_text
from station.devices.zaber.sequences import Script, Sequences
from station.devices.zaber.setup import Port, StageSetup
from station.devices.zaber.shifts import FIRST_ALIAS, alias
from station.devices.zaber.units import Identity, Units


class ZaberStages:
    """`Stages` on Zaber units. Nothing raises out of `poll`, `command` and `stop`: see `condition` and `problem`."""

    def __init__(
        self,
        setups: Sequence[StageSetup],
        ports: Sequence[Port],
        line: Line | None = None,
        reopen: Callable[[Sequence[Port]], Sequence[Port]] | None = None,
    ) -> None:
        """`reopen` opens ports anew whose links have gone; it raises LinkError where it cannot."""
        self._reopen = reopen
        self._units = Units(setups)
        self._sequences = Sequences(self._units)
        self.setups = self._units.setups
        self.condition = Condition.CLOSED
        self.problem = ""  #: why the condition is FAULT
        self.complaints: list[str] = []  #: errors that the units reported by themselves, the last ten
        self._line = line or Line()
        self._scale = [SPEED_UNIT * setup.step for setup in setups]
        self._sent: tuple[list[int], Array] = ([], np.zeros(0))  # in speed units, and as it is told
        self._script: Script | None = None
        self._wait_until = -math.inf
        self._started = self._held_back = False
        self._asked_for: list[float] = []  # velocities that no line has been free for [rad/s or m/s]
        self._use(ports)

    # The control loop's side

    def poll(self, now: float) -> JointReading:
        """Positions at `now` [s]; NaN for a stage that has never answered. Carries everything on."""
        self._sequences.now = now
        for which, chain in enumerate(self._units.chains):
            for happening in chain.feed(self._read(which), now):
                self._happened(which, happening)
        if self._script is not None and now >= self._wait_until and not self._asking:
            self._go_on(Answer())
        if self._held_back:
            self._held_back = False  # `command` follows, with newer velocities
        else:
            self._send(now)
        positions = [zero + step * estimate.position for zero, step, estimate in self._counted]
        sent = [chain.sent[axis] for chain, axis in self._units.where]
        if sent != self._sent[0]:
            self._sent = sent, np.array(self._scale) * sent
        return JointReading(np.array(positions), self._sent[1])

    def command(self, velocities: Array, now: float) -> None:
        """Ask for joint velocities (n,) [rad/s or m/s]; the latest wins. Not heeded unless `ready`; NaN stops."""
        if not self.ready:
            return
        asked: list[float] = velocities.tolist()
        if not all(map(math.isfinite, asked)):
            self.stop(now)
            return
        self._asked_for, self._held_back = asked, True
        self._send(now)

    def stop(self, now: float) -> None:
        """Stop every axis that can be reached, ahead of everything; connecting and homing are given up."""
        if self._script is not None:
            self._end_script()
            self._fail("stopped while connecting" if self.condition is Condition.CONNECTING else "")
        self._asked_for = []
        for chain in self._units.chains:
            chain.stop()
        self._send(now)

    # The station's side

    @property
    def ready(self) -> bool:
        """Connected, homed, and every position is known."""
        if self.condition is not Condition.CONNECTED or not all(self._units.homed):
            return False
        return all([estimate.known for _, _, estimate in self._counted])  # noqa: C419 - at every tick, twice

    @property
    def ports(self) -> tuple[Port, ...]:
        """The lines in use."""
        return self._units.ports

    @property
    def homed(self) -> list[bool]:
        """Which stages know where they are."""
        return self._units.homed

    @property
    def identities(self) -> list[Identity | None]:
        """What each unit has said that it is; None before."""
        return self._units.identities

    @property
    def at_rest(self) -> bool:
        """Every axis that was told to stop has said that it rests."""
        return not any(chain.stopping for chain in self._units.chains)

    @property
    def counts(self) -> list[Counts]:
        """What each axis has got."""
        return [chain.counts[axis] for chain, axis in self._units.where]

    @property
    def lost_bytes(self) -> int:
        """Received bytes that belong to no message."""
        return sum(chain.parser.dropped for chain in self._units.chains)

    def connect(self, now: float, ports: Sequence[Port] | None = None) -> None:
        """Identify and set up every unit; on other ports after a loss. The units must be those of the first time."""
        if ports is None and self._broken and self._reopen is not None:
            try:
                ports = self._reopen(self.ports)
            except LinkError as error:
                self.condition, self.problem = Condition.FAULT, str(error)
                return
        if ports is not None or self.condition is not Condition.CLOSED:
            self._use(ports or self.ports)
        self._sequences.now, self.condition, self.problem = now, Condition.CONNECTING, ""
        self._begin(self._sequences.connect())

    def trouble(self, now: float) -> Trouble | None:  # noqa: ARG002 - it is as at the last poll
        """A FAULT with its cause; what the units complained about by themselves is in `details`."""
        return Trouble(Severity.FAULT, self.problem) if self.condition is Condition.FAULT else None

    def details(self) -> Mapping[str, Any]:
        """Who the units are, where, and how many messages each has got; while they are homed, how far that has come."""
        homing = self._sequences.homing if self.condition is Condition.HOMING else None
        return (
            ({} if homing is None else {"homing": homing.told(self._sequences.now)})
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

        The caller has made sure that the way is clear: a person said so.

        Raises:
            ZaberError: not connected, or busy.
        """
        if self.condition is not Condition.CONNECTED:
            raise ZaberError(f"the stages cannot be homed while they are {self.condition.value}; connect them first")
        self._sequences.now, self.condition = now, Condition.HOMING
        self._begin(self._sequences.home())

    def close(self) -> None:
        """Let go of the ports."""
        self._end_script()
        self.condition = Condition.CLOSED
        for port in self.ports:
            port.link.close()

    # Carrying on

    def _use(self, ports: Sequence[Port]) -> None:
        """Begin anew on these ports."""
        places = sorted(i for port in ports for i in port.stages)
        if places != list(range(len(self.setups))):
            raise ZaberError(f"ports carry the stages {places}; each of 0 ... {len(self.setups) - 1} once is needed")
        self._units.ports = tuple(ports)
        self._end_script()
        self._broken: set[int] = set()
        self._units.chains = []
        where: dict[int, tuple[Chain, int]] = {}
        for port in self.ports:
            setups = [self.setups[i] for i in port.stages]
            axes = [Axis(s.device, s.top, s.acceleration, s.maximum, alias(k)) for k, s in enumerate(setups)]
            if len({axis.device for axis in axes}) < len(axes):
                raise ZaberError(f"two stages on {port.link.name} have the same device number; renumber the chain")
            if any(axis.device >= FIRST_ALIAS for axis in axes):
                raise ZaberError(
                    f"a stage on {port.link.name} has a device number beyond {FIRST_ALIAS - 1}; from {FIRST_ALIAS} on "
                    "they are used as aliases: renumber the chain"
                )
            chain = Chain(axes, self._line)
            self._units.chains.append(chain)
            where |= {i: (chain, k) for k, i in enumerate(port.stages)}
        self._units.where = [where[i] for i in range(len(self.setups))]
        self._counted = [(s.position(0), s.step, self._units.estimate(i)) for i, s in enumerate(self.setups)]

    def _begin(self, script: Script) -> None:
        self._end_script()
        self._script, self._started, self._wait_until = script, False, -math.inf
        self._go_on(Answer())

    def _go_on(self, answer: Answer) -> None:
        """The sequence gets an answer and says what comes next."""
        if self._script is None:
            return
        self._asking = False
        try:
            wish = self._script.send(answer) if self._started else next(self._script)
            self._started = True
        except StopIteration:
            self._script = None
            self.condition = Condition.CONNECTED
        except ZaberError as error:
            self._script = None
            self._fail(str(error))
        else:
            if isinstance(wish, Ask):
                chain, axis = self._units.where[wish.axis]
                self._asking = True
                chain.ask(wish._replace(axis=axis))
            else:
                self._wait_until = self._sequences.now + wish

    def _end_script(self) -> None:
        if self._script is not None:
            self._script.close()
            for chain in self._units.chains:
                chain.cancel()
        self._script, self._asking = None, False

    def _fail(self, why: str) -> None:
        """FAULT with the first cause, or back to CONNECTED where there is none; every axis is stopped."""
        if not why:
            self.condition = Condition.CONNECTED
            for i in range(len(self.setups)):
                self._units.estimate(i).adrift = False
            return
        self._asked_for = []
        if self.condition is not Condition.FAULT:
            self.condition, self.problem = Condition.FAULT, why
        for chain in self._units.chains:
            chain.stop()

    def _happened(self, which: int, happening: Happening) -> None:
        if isinstance(happening, Answer):
            self._go_on(happening)
            return
        i = self.ports[which].stages[happening.axis]
        if isinstance(happening, Lost):
            self._lose((i,), f"{self._line.misses} replies are missing")
        elif isinstance(happening, UnexpectedMotion):
            self._end_script()
            self.homed[i] = False
            self._units.home_again.add(i)
            self._fail(
                f"{self._units.name(i)} does not move as it was told; was it reset, or moved by another program?"
            )
        elif isinstance(happening, Complaint):
            self.complaints = [*self.complaints[-9:], f"{self._units.name(i)}: {error_text(happening.code)}"]
        else:
            self.homed[i] = False
            self._units.home_again.add(i)
            self._units.estimate(i).forget()

    def _lose(self, stages: Sequence[int], why: str) -> None:
        """Stages that cannot be reached: stop the others, and say how far these can run."""
        self._end_script()
        self._units.home_again |= set(stages)
        texts = [f"{self._units.name(i)} cannot be reached ({why}); {self._units.reach(i)}" for i in stages]
        for i in stages:
            self.homed[i] = False
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
            if self._asked_for:
                # Only now: in most ticks the line takes nothing.
                for (on, axis), velocity, scale in zip(self._units.where, self._asked_for, self._scale, strict=True):
                    on.command(axis, round(velocity / scale))
                self._asked_for = []
            if data := chain.due(now):
                try:
                    self._units.ports[which].link.write(data)
                except LinkError as error:
                    self._break(which, error)

    def _break(self, which: int, error: LinkError) -> None:
        """A link that is gone loses all its stages."""
        self._broken.add(which)
        chain = self._units.chains[which]
        chain.lost |= set(range(len(chain.axes)))
        chain.stopping.clear()
        self._lose(self.ports[which].stages, str(error))
