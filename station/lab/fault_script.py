"""Faults that come and go at the simulated devices, each at its time."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from station.config.robots import RobotFile
from station.devices.links.link import Link
from station.lab.aurora.simulated import AuroraFaults, SimulatedAurora
from station.lab.faults import LabFault, Target
from station.lab.netft.simulated import NetftFaults, SimulatedNetft
from station.lab.zaber.simulated import Faults, SimulatedChain

ANALOG_BOARD = 1 << 28  #: of a Net F/T box's status


class Plug(Protocol):
    """What can be pulled."""

    def unplug(self) -> None:
        """Pull it."""
        ...

    def plug(self) -> None:
        """Put it back."""
        ...


class DeviceLine(Link, Plug, Protocol):
    """The device's end of a serial line; without its cable the host's port is gone."""


class Incident(NamedTuple):
    """A fault with its times."""

    fault: LabFault
    target: Target
    begin: float  #: [s]
    end: float  #: infinite: for ever [s]

    @property
    def size(self) -> float:
        """How large the fault is; 0 where it has no size."""
        return self.fault.value or 0.0


class FaultScript:
    """What is wrong with a lab's devices and when. Look at `due` each tick: it costs a comparison."""

    def __init__(
        self,
        robot: RobotFile,
        chain: SimulatedChain,
        aurora: SimulatedAurora,
        boxes: Sequence[SimulatedNetft],
        lines: tuple[DeviceLine, DeviceLine],
    ) -> None:
        """`lines` are those of the chain and of the Aurora."""
        self.due = math.inf  #: when `apply` has something to do next [s]
        self.active: tuple[Incident, ...] = ()  #: what is wrong now
        self._robot, self._chain, self._aurora, self._boxes, self._lines = robot, chain, aurora, tuple(boxes), lines
        self._planned: list[Incident] = []

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Let these happen, instead of those that are on or to come; their times count from `start` [s].

        Raises:
            ConfigError: one cannot happen to this robot's devices.
        """
        targets = [fault.target(self._robot) for fault in faults]
        self._planned.clear()
        if self.active:
            self._become(())
        for fault, target in zip(faults, targets, strict=True):
            begin = start + fault.at
            end = math.inf if fault.duration is None else begin + fault.duration
            self._planned.append(Incident(fault, target, begin, end))
        self._plan()

    def apply(self, now: float) -> None:
        """Begin and end what is due at `now` [s]."""
        begun = tuple(one for one in self._planned if one.begin <= now)
        self._planned = [one for one in self._planned if one.begin > now]
        lasting = tuple(one for one in (*self.active, *begun) if one.end > now and one.fault.kind != "restart")
        self._become(lasting)
        for one in begun:
            if one.fault.kind == "restart":
                self._restart(one.target, now)
        self._plan()

    def _plan(self) -> None:
        times = [one.begin for one in self._planned] + [one.end for one in self.active]
        self.due = min(times, default=math.inf)

    def _become(self, active: tuple[Incident, ...]) -> None:
        """Set every device to what is wrong from now on."""
        self._chain.faults = zaber_faults(active)
        self._aurora.faults = aurora_faults(active)
        for place, box in enumerate(self._boxes):
            box.faults = netft_faults(active, place)
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

    def _restart(self, target: Target, now: float) -> None:
        if target.part == "tracker":
            self._aurora.restart(now)
        for place in target.places:
            if target.part == "sensor":
                self._boxes[place].reboot()
            else:
                self._chain.power_cycle(place + 1)


def zaber_faults(active: Sequence[Incident]) -> Faults:
    """What is wrong with the chain."""
    mine = [one for one in active if one.target.part in ("stages", "joint")]
    places = {kind: frozenset(p + 1 for p in _places(mine, kind)) for kind in ("mute", "stall")}
    cuts = [place + 1 for place in _places(mine, "disconnect")]
    return Faults(
        drop=_worst(mine, "drop_bytes"),
        flip=_worst(mine, "flip_bits"),
        delay=_worst(mine, "delay"),
        mute=places["mute"],
        cut=min(cuts, default=None),
        stalled=places["stall"],
    )


def aurora_faults(active: Sequence[Incident]) -> AuroraFaults:
    """What is wrong with the tracker."""
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


def netft_faults(active: Sequence[Incident], place: int) -> NetftFaults:
    """What is wrong with the box of a tube."""
    mine = [one for one in active if one.target.part == "sensor" and place in one.target.places]
    kinds = {one.fault.kind for one in mine}
    return NetftFaults(
        drop=_worst(mine, "drop_bytes"),
        flip=_worst(mine, "flip_bits"),
        delay=_worst(mine, "delay"),
        # Datagrams have no connection to lose.
        mute=bool(kinds & {"mute", "disconnect"}),
        saturate="saturate" in kinds,
        freeze="freeze" in kinds,
        status=ANALOG_BOARD if "bad_status" in kinds else 0,
    )


def _worst(incidents: Sequence[Incident], kind: str) -> float:
    return max((one.size for one in incidents if one.fault.kind == kind), default=0.0)


def _places(incidents: Sequence[Incident], kind: str) -> list[int]:
    return [place for one in incidents if one.fault.kind == kind for place in one.target.places]
