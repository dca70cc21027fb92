"""The Zaber units of the stages: the chain, the identity and the homing state of each unit."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from station.devices.zaber.chain import ZaberChain
from station.devices.zaber.estimate import AxisEstimate
from station.devices.zaber.setup import PortSetup, StageSetup


class Identity(NamedTuple):
    """Identity that a unit reports."""

    device_id: int
    firmware: int  #: firmware version with two implied decimals: 523 is 5.23
    serial: int | None  #: serial number; None for old units, which have none


class Units:
    """State of all stages' units; identities and homing states persist when the ports change."""

    def __init__(self, setups: Sequence[StageSetup]) -> None:
        self.setups = tuple(setups)
        self.identities: list[Identity | None] = [None for _ in setups]
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()  #: stages that must be homed even if their units report to be homed
        self.homing_distance = [0.0 for _ in setups]  #: distance moved since an unfinished homing began [rad or m]
        self.ports: tuple[PortSetup, ...] = ()
        self.chains: list[ZaberChain] = []  #: one for each port
        self.where: list[tuple[ZaberChain, int]] = []  #: chain and axis of each stage

    def estimate(self, i: int) -> AxisEstimate:
        """Return the position estimate of a stage's axis [microsteps]."""
        chain, axis = self.where[i]
        return chain.estimates[axis]

    def alias(self, i: int) -> int:
        """Return the alias of a stage's unit."""
        chain, axis = self.where[i]
        return chain.axes[axis].alias or 0

    def name(self, i: int) -> str:
        """Return the name of a stage's joint, with its device number and its port, for messages."""
        link = next(port.link for port in self.ports if i in port.stages)
        return f"{self.setups[i].joint.name} (device {self.setups[i].device} on {link.name})"

    def reach(self, i: int) -> str:
        """Return how far a stage that no longer receives commands can still move, as text."""
        chain, axis = self.where[i]
        setup, count, speed = self.setups[i], chain.estimates[axis].position, chain.sent[axis]
        if speed == 0 or not math.isfinite(count):
            return "it was not moving" if speed == 0 else "its position was unknown"
        end = setup.maximum if speed > 0 else 0
        scale, unit = (180.0 / math.pi, "deg") if setup.joint.motion == "rotation" else (1e3, "mm")
        last, bound = scale * setup.position(count), scale * setup.position(end)
        return (
            f"last seen at {last:.1f} {unit}, it can run on to {bound:.1f} {unit},"
            f" {abs(bound - last):.1f} {unit} away (hardware maximum position)"
        )
