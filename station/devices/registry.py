"""Drivers by name: those that come with the station, and installed ones, by the entry points `ctr_station.devices`.

An installed driver is a callable `open(options, robot)` that returns a device as `interfaces.py` has it. `options`
is its table of the station file without the name of the driver; what it raises ends the opening of all devices.
That of stages has an attribute `emergency_stop(options, robot, clock)`: it stops them from another process.
"""

from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.built_in import aurora, netft, nidaq, zaber
from station.devices.interfaces import BaseSensors, EmergencyStop, Stages, Tracker
from station.devices.zaber.emergency_stop import zaber_emergency_stop

GROUP = "ctr_station.devices"

DeviceKind = Literal["stages", "tracker", "sensors"]
#: Opens a device; everything that was told about it has been checked.
Opener = Callable[[], Any]
#: Checks what is told about a device, and says how to open it.
Driver = Callable[[Mapping[str, Any], RobotFile], Opener]

INTERFACES: dict[DeviceKind, type] = {"stages": Stages, "tracker": Tracker, "sensors": BaseSensors}
BUILT_IN: dict[DeviceKind, dict[str, Driver]] = {
    "stages": {"zaber": zaber},
    "tracker": {"aurora": aurora},
    "sensors": {"netft": netft, "nidaq": nidaq},
}
#: Of the stages' own drivers.
EMERGENCY_STOPS: dict[str, Callable[[Mapping[str, Any], RobotFile], EmergencyStop]] = {"zaber": zaber_emergency_stop}


def find(kind: DeviceKind, name: str) -> Driver:
    """The driver of that name; one of the station's own comes first.

    Raises:
        ConfigError: there is none, or it cannot be loaded.
    """
    if name in BUILT_IN[kind]:
        return BUILT_IN[kind][name]
    where, opens = _loaded(kind, name)

    def driver(options: Mapping[str, Any], robot: RobotFile) -> Opener:
        return partial(_opened, kind, where, opens, options, robot)

    return driver


def emergency_stop(stages: Mapping[str, Any], robot: RobotFile) -> EmergencyStop | None:
    """How the stages of `[devices.stages]` are stopped when the process that drives them cannot do it any more.

    None: their driver has no such way.

    Raises:
        ConfigError: there is no such driver, or it cannot be loaded.
    """
    told = dict(stages)
    name = told.pop("driver")
    if name in BUILT_IN["stages"]:
        return EMERGENCY_STOPS[name](told, robot)
    stop = getattr(_loaded("stages", name)[1], "emergency_stop", None)
    return None if stop is None else partial(stop, told, robot)


def _loaded(kind: DeviceKind, name: str) -> tuple[str, Callable[..., Any]]:
    """An installed driver: where it comes from, for a person, and its callable."""
    installed = entry_points(group=GROUP)
    found = list(installed.select(name=name))
    if not found:
        known = [*BUILT_IN[kind], *sorted({point.name for point in installed})]
        raise ConfigError(
            f"devices.{kind}.driver = '{name}' is not one of {', '.join(known)}; "
            f"a driver of your own is an entry point of the group {GROUP}"
        )
    if len(found) > 1:
        raise ConfigError(
            f"devices.{kind}.driver = '{name}' is installed more than once: "
            f"{', '.join(map(_origin, found))}; remove all but one"
        )
    (point,) = found
    where = f"devices.{kind}.driver = '{point.name}' ({_origin(point)})"
    try:
        opens = point.load()
    except Exception as error:  # whatever foreign code does when it is imported
        raise ConfigError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(opens):
        raise ConfigError(f"{where} is no callable open(options, robot)")
    return where, opens


def _opened(
    kind: DeviceKind, where: str, opens: Callable[..., Any], options: Mapping[str, Any], robot: RobotFile
) -> Any:
    """A foreign device, if it is one; raises ConfigError."""
    device = opens(options, robot)
    interface = INTERFACES[kind]
    missing = [name for name in dir(interface) if not name.startswith("_") and not hasattr(device, name)]
    if missing:
        if callable(close := getattr(device, "close", None)):
            close()
        raise ConfigError(f"{where} gave a {type(device).__name__} without {', '.join(missing)}, which {kind} need")
    return device


def _origin(point: EntryPoint) -> str:
    """Where an entry point comes from."""
    return point.value if point.dist is None else f"{point.value} of {point.dist.name}"
