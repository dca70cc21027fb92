"""The Zaber units behind the stages: on which chain each is, who it says that it is, and whether it is homed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from station.devices.zaber.chain import Chain
from station.devices.zaber.estimate import Estimate
from station.devices.zaber.setup import Port, StageSetup


class Identity(NamedTuple):
    """What a unit says that it is."""

    device_id: int
    firmware: int  #: two implied decimals: 523 is 5.23
    serial: int | None


class Units:
    """What is known of the unit of each stage; who it is and whether it is homed outlast a change of ports."""

    def __init__(self, setups: Sequence[StageSetup]) -> None:
        self.setups = tuple(setups)
        self.identities: list[Identity | None] = [None for _ in setups]
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()  #: stages that must be homed whatever their units say
        self.way_home = [0.0 for _ in setups]  #: on which a stage is or was stopped [rad or m]
        self.ports: tuple[Port, ...] = ()
        self.chains: list[Chain] = []  #: one for each port
        self.where: list[tuple[Chain, int]] = []  #: chain and axis of each stage

    def estimate(self, i: int) -> Estimate:
        """Where the axis of a stage is [microsteps]."""
        chain, axis = self.where[i]
        return chain.estimates[axis]

    def alias(self, i: int) -> int:
        """Second number of the unit of a stage."""
        chain, axis = self.where[i]
        return chain.axes[axis].alias or 0

    def name(self, i: int) -> str:
        """The stage, its number and its line, for a message."""
        link = next(port.link for port in self.ports if i in port.stages)
        return f"{self.setups[i].joint.name} (device {self.setups[i].device} on {link.name})"

    def reach(self, i: int) -> str:
        """How far a stage that hears nothing can run."""
        chain, axis = self.where[i]
        setup, count, speed = self.setups[i], chain.estimates[axis].position, chain.sent[axis]
        if speed == 0 or not math.isfinite(count):
            return "it was not moving" if speed == 0 else "where it is was not known"
        end = setup.maximum if speed > 0 else 0
        scale, unit = (180.0 / math.pi, "deg") if setup.joint.motion == "rotation" else (1e3, "mm")
        last, bound = scale * setup.position(count), scale * setup.position(end)
        return (
            f"last seen at {last:.1f} {unit}, it can run on to {bound:.1f} {unit},"
            f" {abs(bound - last):.1f} {unit} away (hardware maximum position)"
        )
