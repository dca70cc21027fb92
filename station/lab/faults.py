"""Faults of the simulated devices, as configured in an experiment file.

```toml
[[faults]]
kind = "drop_bytes"
device = "stages"
at = 20.0
duration = 5.0
value = 0.02
```
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, Self

from pydantic import model_validator

from station.config.robots import RobotFile
from station.config.strict import ConfigError, NotNegative, Positive, Strict

Part = Literal["stages", "joint", "tracker", "sensor"]
FaultKind = Literal[
    "drop_bytes",
    "flip_bits",
    "delay",
    "mute",
    "disconnect",
    "restart",
    "stall",
    "lose_tool",
    "lose_target",
    "unplug",
    "jump",
    "saturate",
    "freeze",
    "bad_status",
]


class FaultProperties(NamedTuple):
    """Properties of a kind of fault: possible targets, bound of the fault's size, and whether the fault has a duration.

    A kind without a duration happens at one time.
    """

    parts: tuple[Part, ...]
    maximum: float | None = None  #: largest `value` of the fault, which is above 0; None: the kind has no value
    unit: str = ""
    lasts: bool = True


PROBABILITY, MAX_DELAY_S, MAX_JUMP_M = 1.0, 60.0, 0.5
SERIAL_TARGETS: tuple[Part, ...] = ("stages", "tracker", "sensor")
FAULT_TARGETS: tuple[Part, ...] = ("stages", "joint", "tracker", "sensor")
FAULT_KINDS: dict[FaultKind, FaultProperties] = {
    # `value` is the share of bytes, or of a force sensor's datagrams, that are lost in both directions
    "drop_bytes": FaultProperties(SERIAL_TARGETS, PROBABILITY, "probability"),
    "flip_bits": FaultProperties(SERIAL_TARGETS, PROBABILITY, "probability"),
    # `value` is the additional delay of every reply
    "delay": FaultProperties(SERIAL_TARGETS, MAX_DELAY_S, "s"),
    # the device does not reply
    "mute": FaultProperties(FAULT_TARGETS),
    # stages, tracker: the computer's port disappears; joint: the cable to its unit is cut, so the units behind are also
    # disconnected; sensor: the network of the box is disconnected
    "disconnect": FaultProperties(FAULT_TARGETS),
    # the device is switched off and on
    "restart": FaultProperties(FAULT_TARGETS, lasts=False),
    # the motor counts steps without moving
    "stall": FaultProperties(("joint",)),
    # the tracker does not see the coil
    "lose_tool": FaultProperties(("tracker",)),
    # the tracker does not see the target's coil
    "lose_target": FaultProperties(("tracker",)),
    # the coil's plug is pulled
    "unplug": FaultProperties(("tracker",)),
    # `value` is the offset of the coil's position along the world's x axis
    "jump": FaultProperties(("tracker",), MAX_JUMP_M, "m"),
    # the sensor reads as overloaded
    "saturate": FaultProperties(("sensor",)),
    # the device repeats one sample or frame
    "freeze": FaultProperties(("tracker", "sensor")),
    # the box reports a failure of its analog board
    "bad_status": FaultProperties(("sensor",)),
}


class FaultTarget(NamedTuple):
    """The devices that a fault affects."""

    part: Part
    indices: tuple[int, ...]  #: indices of joints or tubes, in the robot file's order


class LabFault(Strict):
    """One fault of a simulated device."""

    kind: FaultKind
    device: str
    """stages, tracker, sensors, or one of them by its joint's or tube's name"""
    at: NotNegative = 0.0
    """start time of the fault, relative to the motion's start or to the injection [s]"""
    duration: Positive | None = None
    """duration of the fault [s]; None: permanent"""
    value: Positive | None = None
    """size of the fault: a probability, a delay [s] or a jump [m]"""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        kind = FAULT_KINDS[self.kind]
        if kind.maximum is None and self.value is not None:
            raise ValueError(f"'{self.kind}' has no value")
        if kind.maximum is not None and (self.value is None or self.value > kind.maximum):
            raise ValueError(f"'{self.kind}' needs a value above 0, at most {kind.maximum:g} ({kind.unit})")
        if not kind.lasts and self.duration is not None:
            raise ValueError(f"'{self.kind}' happens at once and has no duration")
        return self

    def target(self, robot: RobotFile) -> FaultTarget:
        """Return the devices that the fault affects.

        Raises:
            ConfigError: the robot has no such device, or the device cannot have this fault.
        """
        joints, tubes = [joint.name for joint in robot.joints], [tube.name for tube in robot.tubes]
        whole: dict[str, FaultTarget] = {
            "stages": FaultTarget("stages", tuple(range(len(joints)))),
            "tracker": FaultTarget("tracker", ()),
            "sensors": FaultTarget("sensor", tuple(range(len(tubes)))),
        }
        found = [whole[self.device]] if self.device in whole else []
        found += [FaultTarget("joint", (i,)) for i, name in enumerate(joints) if name == self.device]
        found += [FaultTarget("sensor", (i,)) for i, name in enumerate(tubes) if name == self.device]
        if not found:
            names = ", ".join([*whole, *joints, *tubes])
            raise ConfigError(f"device = '{self.device}': expected one of {names} (robot '{robot.name}')")
        possible = [target for target in found if target.part in FAULT_KINDS[self.kind].parts]
        if not possible:
            able = [kind for kind, about in FAULT_KINDS.items() if found[0].part in about.parts]
            raise ConfigError(f"kind = '{self.kind}': '{self.device}' cannot have it, but {', '.join(able)}")
        if len(possible) > 1:
            raise ConfigError(f"device = '{self.device}': robot '{robot.name}' has a joint and a tube of that name")
        return possible[0]


def check_faults(faults: Sequence[LabFault], robot: RobotFile) -> None:
    """Check that this robot's devices can have the faults; raises ConfigError with the key."""
    for number, fault in enumerate(faults):
        try:
            fault.target(robot)
        except ConfigError as error:
            raise ConfigError(f"faults.{number}.{error}") from None
