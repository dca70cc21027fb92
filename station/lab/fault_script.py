"""Starts and ends the configured faults of the simulated devices at their times."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from station.config.robots import RobotFile
from station.devices.links.link import Link
from station.lab.aurora.simulated import AuroraFaults, SimulatedAurora
from station.lab.faults import FaultTarget, LabFault
from station.lab.netft.simulated import NetftFaults, SimulatedNetft
from station.lab.zaber.simulated import Faults, SimulatedChain

ANALOG_BOARD = 1 << 28  #: status bit of a Net F/T box that reports a failure of its analog board


class Plug(Protocol):
    """A plug that can be pulled."""

    def unplug(self) -> None:
        """Pull the plug."""
        ...

    def plug(self) -> None:
        """Insert the plug again."""
        ...


class DeviceLine(Link, Plug, Protocol):
    """The device's end of a serial line; if its cable is unplugged, the host's port disappears."""


class Incident(NamedTuple):
    """A fault with its start and end time."""

    fault: LabFault
    target: FaultTarget
    start: float  #: [s]
    end: float  #: [s]; infinite: permanent

    @property
    def size(self) -> float:
        """Size of the fault; 0 for a kind without a size."""
        return self.fault.value or 0.0


class FaultScript:
    """Schedule of the faults of a lab's devices. Call `apply` in a tick only if the time has reached `due`."""

    def __init__(
        self,
        robot: RobotFile,
        chain: SimulatedChain,
        aurora: SimulatedAurora,
        boxes: Sequence[SimulatedNetft],
        lines: tuple[DeviceLine, DeviceLine],
    ) -> None:
        """`lines` are the lines of the chain and of the Aurora."""
        self.due = math.inf  #: time at which the next fault starts or ends, for `apply` [s]
        self.active: tuple[Incident, ...] = ()  #: faults that are active now
        self._robot, self._chain, self._aurora, self._boxes, self._lines = robot, chain, aurora, tuple(boxes), lines
        self._planned: list[Incident] = []

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Replace all active and planned faults; times count from `start` [s].

        Raises:
            ConfigError: this robot's devices cannot have one of the faults.
        """
        targets = [fault.target(self._robot) for fault in faults]
        self._planned.clear()
        if self.active:
            self._become(())
        for fault, target in zip(faults, targets, strict=True):
            first = start + fault.at
            end = math.inf if fault.duration is None else first + fault.duration
            self._planned.append(Incident(fault, target, first, end))
        self._plan()

    def apply(self, now: float) -> None:
        """Start and end the faults that are due at `now` [s]."""
        started = tuple(one for one in self._planned if one.start <= now)
        self._planned = [one for one in self._planned if one.start > now]
        lasting = tuple(one for one in (*self.active, *started) if one.end > now and one.fault.kind != "restart")
        self._become(lasting)
        for one in started:
            if one.fault.kind == "restart":
                self._restart(one.target, now)
        self._plan()

    def _plan(self) -> None:
        times = [one.start for one in self._planned] + [one.end for one in self.active]
        self.due = min(times, default=math.inf)

    def _become(self, active: tuple[Incident, ...]) -> None:
        """Set the active faults of every device."""
        self._chain.faults = zaber_faults(active)
        self._aurora.faults = aurora_faults(active)
        for index, box in enumerate(self._boxes):
            box.faults = netft_faults(active, index)
        for part, line in zip(("stages", "tracker"), self._lines, strict=True):
            self._switch("disconnect", part, active, line)
        self._switch("unplug", "tracker", active, self._aurora)
        self.active = active

    def _switch(self, kind: str, part: str, active: tuple[Incident, ...], plug: Plug) -> None:
        def out(incidents: tuple[Incident, ...]) -> bool:
            return any(one.fault.kind == kind and one.target.part == part for one in incidents)

        if out(active) and not out(self.active):
            plug.unplug()
        elif out(self.active) and not out(active):
            plug.plug()

    def _restart(self, target: FaultTarget, now: float) -> None:
        if target.part == "tracker":
            self._aurora.restart(now)
        for index in target.indices:
            if target.part == "sensor":
                self._boxes[index].reboot()
            else:
                self._chain.power_cycle(index + 1)


def zaber_faults(active: Sequence[Incident]) -> Faults:
    """Return the active faults of the stages' chain, as the simulated chain expects them."""
    mine = [one for one in active if one.target.part in ("stages", "joint")]
    slots = {kind: frozenset(i + 1 for i in _indices(mine, kind)) for kind in ("mute", "stall")}
    cuts = [index + 1 for index in _indices(mine, "disconnect")]
    return Faults(
        drop=_worst(mine, "drop_bytes"),
        flip=_worst(mine, "flip_bits"),
        delay=_worst(mine, "delay"),
        mute=slots["mute"],
        cut=min(cuts, default=None),
        stalled=slots["stall"],
    )


def aurora_faults(active: Sequence[Incident]) -> AuroraFaults:
    """Return the active faults of the tracker, as the simulated Aurora expects them."""
    mine = [one for one in active if one.target.part == "tracker"]
    kinds = {one.fault.kind for one in mine}
    return AuroraFaults(
        drop=_worst(mine, "drop_bytes"),
        flip=_worst(mine, "flip_bits"),
        delay=_worst(mine, "delay"),
        mute="mute" in kinds,
        tool_lost="lose_tool" in kinds,
        target_lost="lose_target" in kinds,
        jump=_worst(mine, "jump"),
        freeze="freeze" in kinds,
    )


def netft_faults(active: Sequence[Incident], index: int) -> NetftFaults:
    """Return the active faults of the force sensor at tube `index`, as its simulated Net F/T box expects them."""
    mine = [one for one in active if one.target.part == "sensor" and index in one.target.indices]
    kinds = {one.fault.kind for one in mine}
    return NetftFaults(
        drop=_worst(mine, "drop_bytes"),
        flip=_worst(mine, "flip_bits"),
        delay=_worst(mine, "delay"),
        # Datagrams have no connection, so a disconnected box is mute.
        mute=bool(kinds & {"mute", "disconnect"}),
        saturate="saturate" in kinds,
        freeze="freeze" in kinds,
        status=ANALOG_BOARD if "bad_status" in kinds else 0,
    )


def _worst(incidents: Sequence[Incident], kind: str) -> float:
    return max((one.size for one in incidents if one.fault.kind == kind), default=0.0)


def _indices(incidents: Sequence[Incident], kind: str) -> list[int]:
    return [index for one in incidents if one.fault.kind == kind for index in one.target.indices]
