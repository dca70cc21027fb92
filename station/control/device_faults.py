"""Faults of the devices, and the change of state that follows from the worst fault."""

from types import MappingProxyType

import numpy as np

from station.control.states import Transition
from station.devices.interfaces import DeviceFault, Devices, JointReading, Severity, TipReading, WrenchReading

Troubles = tuple[
    DeviceFault | None, DeviceFault | None, DeviceFault | None
]  # faults of stages, tracker and force sensors
#: Severities of stages, tracker and force sensors while no device has a fault.
NO_FAULT = (0, 0, 0)
#: Transition that a fault of each severity causes.
EVENT_BY_SEVERITY = MappingProxyType(
    {Severity.HOLD: Transition.HOLD, Severity.STOP: Transition.STOP, Severity.FAULT: Transition.FAULT}
)


def device_faults(devices: Devices, now: float) -> Troubles:
    """Return the faults of stages, tracker and force sensors at `now` [s]."""
    return devices.stages.trouble(now), devices.tracker.trouble(now), devices.sensors.trouble(now)


def worst_fault(found: Troubles) -> DeviceFault | None:
    """Return the fault with the highest severity, of equal faults the first; None without a fault."""
    result = None
    for trouble in found:
        if trouble is not None and (result is None or trouble.severity > result.severity):
            result = trouble
    return result


def severities(found: Troubles) -> tuple[int, int, int]:
    """Return the severities of stages, tracker and force sensors; 0 without a fault."""
    stages, tracker, sensors = (0 if one is None else int(one.severity) for one in found)
    return stages, tracker, sensors


def blocks_motion(trouble: DeviceFault | None) -> bool:
    """Return whether a device's fault forbids motion."""
    return trouble is not None and trouble.severity is not Severity.WARN


def not_finite(joints: JointReading, frame: TipReading | None, wrenches: WrenchReading) -> str:
    """Return a text that names the device with a NaN or infinite reading; empty if all readings are finite."""
    readings = (
        ("stages: positions", joints.positions),
        ("tracker: position", None if frame is None else frame.position),
        ("force sensors: wrenches", wrenches.wrenches),
    )
    for name, numbers in readings:
        if numbers is not None and not np.isfinite(numbers).all():
            return f"{name} {numbers.tolist()} are not finite; the sample was not used: check the device, then reset"
    return ""
