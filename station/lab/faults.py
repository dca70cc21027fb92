"""What can go wrong at the simulated devices, as an experiment file says it.

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


class Kind(NamedTuple):
    """A kind of fault: what it can befall, and whether it has a size and an end."""

    parts: tuple[Part, ...]
    most: float | None = None  #: of `value`, which is above 0; None: it has none
    unit: str = ""
    lasts: bool = True


PROBABILITY, LONGEST_DELAY, FARTHEST_JUMP = 1.0, 60.0, 0.5
LINES: tuple[Part, ...] = ("stages", "tracker", "sensor")
ALL: tuple[Part, ...] = ("stages", "joint", "tracker", "sensor")
KINDS: dict[FaultKind, Kind] = {
    # a part of the bytes, of a force sensor's datagrams, either way
    "drop_bytes": Kind(LINES, PROBABILITY, "probability"),
    "flip_bits": Kind(LINES, PROBABILITY, "probability"),
    # of every reply on top of the usual
    "delay": Kind(LINES, LONGEST_DELAY, "s"),
    # nothing is answered
    "mute": Kind(ALL),
    # the computer's port is gone; the cable to a joint's unit, and with it to those behind; a sensor's network
    "disconnect": Kind(ALL),
    # off and on
    "restart": Kind(ALL, lasts=False),
    # the motor counts steps that it does not make
    "stall": Kind(("joint",)),
    # the coil is not seen
    "lose_tool": Kind(("tracker",)),
    # the same of the target's coil, where there is one
    "lose_target": Kind(("tracker",)),
    # the coil's plug is pulled
    "unplug": Kind(("tracker",)),
    # the coil seems to be so far off, along the world's x
    "jump": Kind(("tracker",), FARTHEST_JUMP, "m"),
    "saturate": Kind(("sensor",)),
    # the same sample or frame again and again
    "freeze": Kind(("tracker", "sensor")),
    # the box says that its analog board has failed
    "bad_status": Kind(("sensor",)),
}


class Target(NamedTuple):
    """Whom a fault befalls."""

    part: Part
    places: tuple[int, ...]  #: of joints or tubes, in the robot's order


class LabFault(Strict):
    """One fault of a simulated device."""

    kind: FaultKind
    device: str
    """stages, tracker, sensors, or one of them by its joint's or tube's name"""
    at: NotNegative = 0.0
    """from the motion's start, or from now on when it is injected [s]"""
    duration: Positive | None = None
    """None: for ever [s]"""
    value: Positive | None = None
    """how much: a probability, of a delay seconds, of a jump metres"""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        kind = KINDS[self.kind]
        if kind.most is None and self.value is not None:
            raise ValueError(f"'{self.kind}' has no value")
        if kind.most is not None and (self.value is None or self.value > kind.most):
            raise ValueError(f"'{self.kind}' needs a value above 0, at most {kind.most:g} ({kind.unit})")
        if not kind.lasts and self.duration is not None:
            raise ValueError(f"'{self.kind}' happens at once and has no duration")
        return self

    def target(self, robot: RobotFile) -> Target:
        """Whom it befalls.

        Raises:
            ConfigError: the robot has no such device, or this cannot happen to it.
        """
        joints, tubes = [joint.name for joint in robot.joints], [tube.name for tube in robot.tubes]
        whole: dict[str, Target] = {
            "stages": Target("stages", tuple(range(len(joints)))),
            "tracker": Target("tracker", ()),
            "sensors": Target("sensor", tuple(range(len(tubes)))),
        }
        found = [whole[self.device]] if self.device in whole else []
        found += [Target("joint", (i,)) for i, name in enumerate(joints) if name == self.device]
        found += [Target("sensor", (i,)) for i, name in enumerate(tubes) if name == self.device]
        if not found:
            names = ", ".join([*whole, *joints, *tubes])
            raise ConfigError(f"device = '{self.device}': expected one of {names} (robot '{robot.name}')")
        possible = [target for target in found if target.part in KINDS[self.kind].parts]
        if not possible:
            able = [kind for kind, about in KINDS.items() if found[0].part in about.parts]
            raise ConfigError(f"kind = '{self.kind}': to '{self.device}' can happen {', '.join(able)}")
        if len(possible) > 1:
            raise ConfigError(f"device = '{self.device}': robot '{robot.name}' has a joint and a tube of that name")
        return possible[0]


def check_faults(faults: Sequence[LabFault], robot: RobotFile) -> None:
    """Refuse faults that cannot happen to this robot's devices; raises ConfigError with the key."""
    for number, fault in enumerate(faults):
        try:
            fault.target(robot)
        except ConfigError as error:
            raise ConfigError(f"faults.{number}.{error}") from None
