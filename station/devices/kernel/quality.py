"""Quality of a sample of a tracker or force sensor, and the fault that follows from it and from its duration."""

import math
from collections.abc import Sequence
from enum import IntFlag
from types import MappingProxyType
from typing import NamedTuple

from station.devices.interfaces import DeviceFault, Severity


class Quality(IntFlag):
    """Flags of what is wrong with the newest sample; 0: nothing. The most specific reason has the lowest number."""

    GOOD = 0
    LOST = 1  #: the connection to the device is lost
    CONNECTING = 2  #: the device is being set up
    RESTARTED = 4  #: the device has restarted since its samples were requested: its zero is unknown
    WRONG_RATE = 8  #: the device does not measure at the configured or needed rate
    SATURATED = 16  #: the transducer or its converter is saturated
    DEVICE_FAULT = 32  #: the device reports a fault of itself or of its transducer
    RANGE = 64  #: the wrench is outside the calibrated range, although the device reports no fault
    OUT_OF_VOLUME = 128  #: the coil is fully or partly outside the measurement volume
    DISABLED = 256  #: the coil is disabled or unplugged
    MISSING = 512  #: the device does not detect what it should measure
    JUMP = 1024  #: the position is further from the last one than the tip can move in the time between
    DISAGREEING = 2048  #: the parts of the device contradict each other, or are too uncertain together
    UNREADABLE = 4096  #: messages arrive, and none can be used
    SILENT = 8192  #: no message arrives
    STALE = 16384  #: no usable sample for too long, or none yet
    LATCHED = 32768  #: a monitor condition has latched in the device; the sample is usable
    GAP = 65536  #: samples were lost since the last poll; the newest sample is usable

    @property
    def is_usable(self) -> bool:
        """Whether the sample is valid for control."""
        return not self & ~(Quality.LATCHED | Quality.GAP)

    @property
    def words(self) -> list[str]:
        """Names of the flags, for the person who repairs the device."""
        return [str(flag.name).lower().replace("_", " ") for flag in Quality if flag in self]


#: Predicate of the fault's sentence for each quality; `{since}` is replaced by the duration.
HAPPENED = MappingProxyType(
    {
        Quality.LOST: "is not connected{since}",
        Quality.CONNECTING: "is still starting{since}",
        Quality.RESTARTED: "has restarted{since}, so its zero is unknown",
        Quality.WRONG_RATE: "measures with a wrong rate{since}",
        Quality.SATURATED: "is saturated{since}: take the load off",
        Quality.DEVICE_FAULT: "reports a fault{since}",
        Quality.RANGE: "measures more than its calibration allows{since}: take the load off",
        Quality.OUT_OF_VOLUME: "measured the coil outside its volume{since}",
        Quality.DISABLED: "has a coil that is disabled or unplugged{since}",
        Quality.MISSING: "lost the coil{since}",
        Quality.JUMP: "measured positions that jumped, and no valid one arrived{since}",
        Quality.DISAGREEING: "has cameras that contradict each other{since}",
        Quality.UNREADABLE: "sends messages that cannot be read{since}",
        Quality.SILENT: "was silent{since}",
        Quality.STALE: "sent no new usable sample{since}",
    }
)


class Sampled(NamedTuple):
    """State of one device, from which its fault follows."""

    name: str  #: subject of the fault's sentence
    quality: Quality
    age: float  #: time since the last good sample was measured; infinite before the first one [s]
    details: str = ""  #: device, address and raw values, for the person who repairs it
    because: str = ""  #: predicate of the fault's sentence, which may contain `{since}`; empty: that of the quality


def happened(sampled: Sampled) -> str:
    """Return the sentence that states what has happened to a device."""
    since = "" if math.isinf(sampled.age) or sampled.age < 0.005 else f" for {sampled.age:.2f} s"
    first = next((flag for flag in HAPPENED if flag & sampled.quality), Quality.STALE)
    return f"{sampled.name} {(sampled.because or HAPPENED[first]).replace('{since}', since)}"


def sample_fault(devices: Sequence[Sampled], hold_after: float = 0.0) -> DeviceFault:
    """Return the fault of devices: a HOLD if one is lost or had no good sample for `hold_after` [s], else a WARN."""
    hold = any(device.quality & Quality.LOST or device.age > hold_after for device in devices)
    details = "; ".join(device.details for device in devices if device.details)
    return DeviceFault(Severity.HOLD if hold else Severity.WARN, "; ".join(map(happened, devices)), details)


def quoted(data: bytes, most: int = 12) -> str:
    """Return the first bytes of a message as text or in hexadecimal, to show what a device has sent."""
    part = data[:most]
    is_text = all(32 <= byte < 127 or byte in b"\r\n\t" for byte in part)
    shown = repr(part.decode("ascii")) if is_text else part.hex(" ")
    return f"{shown} ... ({len(data)} bytes)" if len(data) > most else shown
