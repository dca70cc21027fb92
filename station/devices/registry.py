"""Drivers by name: those that come with the station, and installed ones, by the entry points `ctr_station.devices`.

An installed driver is a callable `open(options, robot)` that returns a device as `interfaces.py` has it. `options`
is its table of the station file without the name of the driver; what it raises ends the opening of all devices.
"""

from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.built_in import aurora, netft, nidaq, zaber
from station.devices.interfaces import BaseSensors, Stages, Tracker

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


def find(kind: DeviceKind, name: str) -> Driver:
    """The driver of that name; one of the station's own comes first.

    Raises:
        ConfigError: there is none, or it cannot be loaded.
    """
    if name in BUILT_IN[kind]:
        return BUILT_IN[kind][name]
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
    return _installed(kind, found[0])


def _installed(kind: DeviceKind, point: EntryPoint) -> Driver:
    where = f"devices.{kind}.driver = '{point.name}' ({_origin(point)})"
    try:
        opens = point.load()
    except Exception as error:  # whatever foreign code does when it is imported
        raise ConfigError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(opens):
        raise ConfigError(f"{where} is no callable open(options, robot)")

    def driver(options: Mapping[str, Any], robot: RobotFile) -> Opener:
        return partial(_opened, kind, where, opens, options, robot)

    return driver


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
