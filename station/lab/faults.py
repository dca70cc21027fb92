"""Faults of the simulated devices, as configured in an experiment file, and their schedule.

```toml
[[faults]]
kind = "drop_bytes"
device = "stages"
at = 20.0
duration = 5.0
value = 0.02
```
"""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Self

from pydantic import model_validator

from station.config.robots import RobotFile
from station.config.strict import ConfigError, NotNegative, Positive, Strict
from station.lab.simulated_aurora import AuroraFaults, SimulatedAurora
from station.lab.simulated_line import Faults, SimulatedStages
from station.lab.simulated_netft import NetftFaults, SimulatedNetft
from station.lab.wires import DeviceLine, Plug

Part = Literal["stages", "joint", "tracker", "sensor"]
FaultKind = Literal[
    "drop_bytes",
    "flip_bits",
    "delay",
    "mute",
    "disconnect",
    "restart",
    "stall",
    "clamp",
    "lose_tool",
    "lose_target",
    "unplug",
    "jump",
    "noise",
    "saturate",
    "freeze",
    "bad_status",
]


class FaultProperties(NamedTuple):
    """Properties of a kind of fault: effect, possible targets, largest value, and whether it has a duration.

    A fault without a duration happens at one moment.
    """

    effect: str  #: what the fault does, as a sentence
    parts: tuple[Part, ...]
    maximum: float | None = None  #: largest `value` of the fault, which is above 0; None: the kind has no value
    unit: str = ""
    lasts: bool = True


PROBABILITY, MAX_DELAY_S, MAX_JUMP_M, MAX_NOISE_M = 1.0, 60.0, 0.5, 0.1
SERIAL_TARGETS: tuple[Part, ...] = ("stages", "tracker", "sensor")
FAULT_TARGETS: tuple[Part, ...] = ("stages", "joint", "tracker", "sensor")
FAULT_KINDS: dict[FaultKind, FaultProperties] = {
    "drop_bytes": FaultProperties(
        "This share of the bytes (of a force sensor: of its datagrams) is lost in both directions.",
        SERIAL_TARGETS, PROBABILITY, "probability"),
    "flip_bits": FaultProperties(
        "This share of the bytes (of a force sensor: of its datagrams) is damaged in both directions.",
        SERIAL_TARGETS, PROBABILITY, "probability"),
    "delay": FaultProperties("Every reply comes later by this time.", SERIAL_TARGETS, MAX_DELAY_S, "s"),
    "mute": FaultProperties("The device does not reply.", FAULT_TARGETS),
    "disconnect": FaultProperties(
        "Stages, tracker: the computer's port disappears. Joint: the cable to its stage is cut, also for the stages"
        " behind it. Force sensor: its box has no network.", FAULT_TARGETS),
    "restart": FaultProperties("The device is switched off and on.", FAULT_TARGETS, lasts=False),
    "stall": FaultProperties("The motor counts steps without moving.", ("joint",)),
    "clamp": FaultProperties(
        "The stage and its counter do not move, although the device accepts commands.", ("joint",)),
    "lose_tool": FaultProperties("The tracker does not see the coil at the tip.", ("tracker",)),
    "lose_target": FaultProperties("The tracker does not see the coil on the target.", ("tracker",)),
    "unplug": FaultProperties("The plug of the coil at the tip is pulled.", ("tracker",)),
    "jump": FaultProperties("The measured position of the tip moves by this distance along the world's x axis.",
        ("tracker",), MAX_JUMP_M, "m"),
    "noise": FaultProperties(
        "The measured positions have additional noise with this standard deviation on each axis.",
        ("tracker",), MAX_NOISE_M, "m"),
    "saturate": FaultProperties("The force sensor reads as overloaded.", ("sensor",)),
    "freeze": FaultProperties("The device repeats one sample or frame.", ("tracker", "sensor")),
    "bad_status": FaultProperties("The sensor's box reports a failure of its analog board.", ("sensor",)),
}  # fmt: skip


class FaultTarget(NamedTuple):
    """The devices that a fault affects."""

    part: Part
    indices: tuple[int, ...]  #: indices of joints or force sensors, in the robot file's order


class LabFault(Strict):
    """One fault of a simulated device."""

    kind: FaultKind
    device: str
    """stages, tracker, sensors, or one of them by its joint's or tube's name; `robot`: the sensor under the robot"""
    at: NotNegative = 0.0
    """start time of the fault, relative to the motion's start or to the injection [s]"""
    duration: Positive | None = None
    """duration of the fault [s]; None: permanent"""
    value: Positive | None = None
    """size of the fault: a probability, a delay [s], a jump [m] or noise [m]"""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        kind = FAULT_KINDS[self.kind]
        if kind.maximum is None and self.value is not None:
            raise ValueError(f"'{self.kind}' has no value; remove the key value")
        if kind.maximum is not None and (self.value is None or self.value > kind.maximum):
            raise ValueError(f"'{self.kind}' needs a value above 0, at most {kind.maximum:g} ({kind.unit})")
        if not kind.lasts and self.duration is not None:
            raise ValueError(f"'{self.kind}' happens at once and has no duration; remove the key duration")
        return self

    def target(self, robot: RobotFile) -> FaultTarget:
        """Return the devices that the fault affects.

        Raises:
            ConfigError: the robot has no such device, or the device cannot have this fault.
        """
        joints, carried = [joint.name for joint in robot.joints], robot.sensor_names
        whole: dict[str, FaultTarget] = {
            "stages": FaultTarget("stages", tuple(range(len(joints)))),
            "tracker": FaultTarget("tracker", ()),
            "sensors": FaultTarget("sensor", tuple(range(len(carried)))),
        }
        found = [whole[self.device]] if self.device in whole else []
        found += [FaultTarget("joint", (i,)) for i, name in enumerate(joints) if name == self.device]
        found += [FaultTarget("sensor", (i,)) for i, name in enumerate(carried) if name == self.device]
        if not found:
            names = ", ".join([*whole, *joints, *carried])
            raise ConfigError(f"device = '{self.device}': expected one of {names} (robot '{robot.name}')")
        possible = [target for target in found if target.part in FAULT_KINDS[self.kind].parts]
        if not possible:
            able = [kind for kind, about in FAULT_KINDS.items() if found[0].part in about.parts]
            raise ConfigError(f"kind = '{self.kind}': '{self.device}' can have only the faults {', '.join(able)}")
        if len(possible) > 1:
            raise ConfigError(f"device = '{self.device}' is a joint and a tube of robot '{robot.name}'; rename one")
        return possible[0]


def check_faults(faults: Sequence[LabFault], robot: RobotFile) -> None:
    """Check that this robot's devices can have the faults; raises ConfigError with the key."""
    for number, fault in enumerate(faults):
        try:
            fault.target(robot)
        except ConfigError as error:
            raise ConfigError(f"faults.{number}.{error}") from None


ANALOG_BOARD = 1 << 28  #: status bit of a Net F/T box that reports a failure of its analog board


class Incident(NamedTuple):
    """A fault with its start and end time."""

    fault: LabFault
    target: FaultTarget
    start: float  #: start time [s]
    end: float  #: end time [s]; inf: permanent

    @property
    def size(self) -> float:
        """Size of the fault; 0 for a kind without a size."""
        return self.fault.value or 0.0


class FaultScript:
    """Schedule of the faults of a lab's devices. Call `apply` in a tick only if the time has reached `due`."""

    def __init__(
        self,
        robot: RobotFile,
        chain: SimulatedStages,
        aurora: SimulatedAurora,
        boxes: Sequence[SimulatedNetft],
        lines: tuple[DeviceLine, DeviceLine],
    ) -> None:
        """`lines` are the serial lines of the stages and of the Aurora."""
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
    """Return the active faults of the stages in the form that the simulated stages expect."""
    mine = [one for one in active if one.target.part in ("stages", "joint")]
    slots = {kind: frozenset(i + 1 for i in _indices(mine, kind)) for kind in ("mute", "stall", "clamp")}
    cuts = [index + 1 for index in _indices(mine, "disconnect")]
    return Faults(
        **_line_faults(mine),
        mute=slots["mute"],
        cut=min(cuts, default=None),
        stalled=slots["stall"],
        clamped=slots["clamp"],
    )


def aurora_faults(active: Sequence[Incident]) -> AuroraFaults:
    """Return the active faults of the tracker in the form that the simulated Aurora expects."""
    mine = [one for one in active if one.target.part == "tracker"]
    kinds = {one.fault.kind for one in mine}
    return AuroraFaults(
        **_line_faults(mine),
        mute="mute" in kinds,
        tool_lost="lose_tool" in kinds,
        target_lost="lose_target" in kinds,
        jump=_worst(mine, "jump"),
        noise=_worst(mine, "noise"),
        freeze="freeze" in kinds,
    )


def netft_faults(active: Sequence[Incident], index: int) -> NetftFaults:
    """Return the active faults of the force sensor `index` in the form that its simulated box expects."""
    mine = [one for one in active if one.target.part == "sensor" and index in one.target.indices]
    kinds = {one.fault.kind for one in mine}
    return NetftFaults(
        **_line_faults(mine),
        # Datagrams have no connection, so a disconnected box is mute.
        mute=bool(kinds & {"mute", "disconnect"}),
        saturate="saturate" in kinds,
        freeze="freeze" in kinds,
        status=ANALOG_BOARD if "bad_status" in kinds else 0,
    )


def _line_faults(mine: Sequence[Incident]) -> Any:
    """Return the faults that the line of every kind of device can have, as keyword arguments."""
    return {"drop": _worst(mine, "drop_bytes"), "flip": _worst(mine, "flip_bits"), "delay": _worst(mine, "delay")}


def _worst(incidents: Sequence[Incident], kind: str) -> float:
    return max((one.size for one in incidents if one.fault.kind == kind), default=0.0)


def _indices(incidents: Sequence[Incident], kind: str) -> list[int]:
    return [index for one in incidents if one.fault.kind == kind for index in one.target.indices]
