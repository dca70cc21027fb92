"""What is wrong with the devices, and what follows: the worst wins."""

from types import MappingProxyType

import numpy as np

from station.control.states import Event
from station.devices.interfaces import Devices, JointReading, Severity, TipReading, Trouble, WrenchReading

Troubles = tuple[Trouble | None, Trouble | None, Trouble | None]  # of stages, tracker, force sensors
#: Severities when nothing is wrong.
NONE = (0, 0, 0)
#: What a trouble makes of the state.
EVENTS = MappingProxyType({Severity.HOLD: Event.HOLD, Severity.STOP: Event.STOP, Severity.FAULT: Event.FAULT})


def troubles(devices: Devices, now: float) -> Troubles:
    """What is wrong with each device at `now` [s]."""
    return devices.stages.trouble(now), devices.tracker.trouble(now), devices.sensors.trouble(now)


def worst(found: Troubles) -> Trouble | None:
    """The one that counts."""
    result = None
    for trouble in found:
        if trouble is not None and (result is None or trouble.severity > result.severity):
            result = trouble
    return result


def severities(found: Troubles) -> tuple[int, int, int]:
    """Of what is wrong with stages, tracker and force sensors; 0 where nothing is."""
    stages, tracker, sensors = (0 if one is None else int(one.severity) for one in found)
    return stages, tracker, sensors


def holds(trouble: Trouble | None) -> bool:
    """Whether nothing may move with it."""
    return trouble is not None and trouble.severity is not Severity.WARN


def not_finite(joints: JointReading, frame: TipReading | None, wrenches: WrenchReading) -> str:
    """Which device has said nan or inf, and what to do; empty if none has."""
    said = (
        ("stages: positions", joints.positions),
        ("tracker: position", None if frame is None else frame.position),
        ("force sensors: wrenches", wrenches.wrenches),
    )
    for name, numbers in said:
        if numbers is not None and not np.isfinite(numbers).all():
            return f"{name} {numbers.tolist()} are not numbers; nothing of it was used: look at the device, then reset"
    return ""
