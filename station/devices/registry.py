"""Finds drivers by name and opens the devices of a bench, all or none.

A driver is built in, or installed with an entry point `ctr_station.devices`. An installed driver is a callable
`open(options, robot)` that returns a device with an interface of `interfaces.py`. `options` is the device's table of
the station file without the key `driver`. If the callable raises, the station opens no device. A callable for stages
has an attribute `emergency_stop(options, robot, clock)`, a function by which another process stops the stages.
"""

import contextlib
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.ati.netft import netft
from station.devices.ati.nidaq import nidaq
from station.devices.aurora.tracker import aurora
from station.devices.cia402.emergency_stop import cia402_emergency_stop
from station.devices.cia402.stages import cia402
from station.devices.config import BenchFile
from station.devices.gcode.emergency_stop import gcode_emergency_stop
from station.devices.gcode.stages import gcode
from station.devices.interfaces import BaseSensors, DeviceKind, Devices, EmergencyStop, Stages, Tracker
from station.devices.stereo.tracker import stereo
from station.devices.zaber.emergency_stop import zaber_emergency_stop
from station.devices.zaber.stages import zaber
from station.devices.zaber_ascii.emergency_stop import zaber_ascii_emergency_stop
from station.devices.zaber_ascii.stages import zaber_ascii

ENTRY_POINT_GROUP = "ctr_station.devices"

DEVICE_KINDS: tuple[DeviceKind, ...] = ("stages", "tracker", "sensors")
#: Function that opens a device whose options have been checked.
Opener = Callable[[], Any]
#: Function that checks the options of a device and returns the device's opener.
Driver = Callable[[Mapping[str, Any], RobotFile], Opener]

INTERFACES: dict[DeviceKind, type] = {"stages": Stages, "tracker": Tracker, "sensors": BaseSensors}
BUILT_IN_DRIVERS: dict[DeviceKind, dict[str, Driver]] = {
    "stages": {"zaber": zaber, "zaber_ascii": zaber_ascii, "cia402": cia402, "gcode": gcode},
    "tracker": {"aurora": aurora, "stereo": stereo},
    "sensors": {"netft": netft, "nidaq": nidaq},
}
#: Emergency stops of the built-in drivers of stages.
EMERGENCY_STOPS: dict[str, Callable[[Mapping[str, Any], RobotFile], EmergencyStop]] = {
    "zaber": zaber_emergency_stop,
    "zaber_ascii": zaber_ascii_emergency_stop,
    "cia402": cia402_emergency_stop,
    "gcode": gcode_emergency_stop,
}


def find(kind: DeviceKind, name: str) -> Driver:
    """Return the driver of that name; a built-in driver takes precedence.

    Raises:
        ConfigError: there is no driver of that name, or the driver cannot be loaded.
    """
    if name in BUILT_IN_DRIVERS[kind]:
        return BUILT_IN_DRIVERS[kind][name]
    where, opens = _loaded(kind, name)

    def driver(options: Mapping[str, Any], robot: RobotFile) -> Opener:
        return partial(_opened, kind, where, opens, options, robot)

    return driver


def emergency_stop(stages: Mapping[str, Any], robot: RobotFile) -> EmergencyStop | None:
    """Return the emergency stop of the stages in `[devices.stages]`, for use after a crash of the control process.

    The result is None if the stages' driver has no emergency stop.

    Raises:
        ConfigError: there is no such driver, it cannot be loaded, or its emergency_stop is not callable.
    """
    options = dict(stages)
    name = options.pop("driver")
    if name in BUILT_IN_DRIVERS["stages"]:
        return EMERGENCY_STOPS[name](options, robot)
    where, opens = _loaded("stages", name)
    stop: Any = getattr(opens, "emergency_stop", None)
    if stop is not None and not callable(stop):
        raise ConfigError(f"{where}: its emergency_stop is not a callable emergency_stop(options, robot, clock)")
    return None if stop is None else cast(EmergencyStop, partial(cast(Any, stop), options, robot))


def _loaded(kind: DeviceKind, name: str) -> tuple[str, Callable[..., Any]]:
    """Return the origin of an installed driver, for error messages, and the driver's callable."""
    installed = entry_points(group=ENTRY_POINT_GROUP)
    found = list(installed.select(name=name))
    if not found:
        known = [*BUILT_IN_DRIVERS[kind], *sorted({point.name for point in installed})]
        raise ConfigError(
            f"devices.{kind}.driver = '{name}' is not one of {', '.join(known)}; "
            f"a custom driver needs an entry point of the group {ENTRY_POINT_GROUP}"
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
    except (Exception, SystemExit) as error:  # an import of foreign code can raise anything
        raise ConfigError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(opens):
        raise ConfigError(f"{where} is not a callable open(options, robot)")
    return where, opens


def _opened(
    kind: DeviceKind, where: str, opens: Callable[..., Any], options: Mapping[str, Any], robot: RobotFile
) -> Any:
    """Open an installed device and check its interface; raises ConfigError."""
    device = opens(options, robot)
    interface = INTERFACES[kind]
    missing = [name for name in dir(interface) if not name.startswith("_") and not hasattr(device, name)]
    if missing:
        if callable(close := getattr(device, "close", None)):
            close()
        raise ConfigError(f"{where} returned a {type(device).__name__} without {', '.join(missing)}, which {kind} need")
    return device


def _origin(point: EntryPoint) -> str:
    """Return the module, the attribute and the package of an entry point, for error messages."""
    return point.value if point.dist is None else f"{point.value} of {point.dist.name}"


class OpenError(CtrError):
    """A device cannot be opened; the text names its table in the station file, its port and what to do."""


def plan(bench: BenchFile, robot: RobotFile) -> dict[DeviceKind, Opener]:
    """Check the configuration, and return an opener for each device of the bench; no device is opened yet.

    Raises:
        ConfigError: an invalid key; the text names the key, the value and what was expected.
    """
    openers: dict[DeviceKind, Opener] = {}
    for kind in DEVICE_KINDS:
        table: Mapping[str, Any] | None = getattr(bench, kind)
        if table is None:
            continue
        options = dict(table)
        openers[kind] = find(kind, options.pop("driver"))(options, robot)
    return openers


def open_devices(bench: BenchFile, robot: RobotFile) -> Devices:
    """Open every device of a bench without connecting it. The call may wait for the web page of a force sensor's box.

    Raises:
        ConfigError: an invalid key; the text names the key, the value and what was expected.
        OpenError: a device cannot be opened; the devices opened before it have been closed again.
    """
    openers = plan(bench, robot)
    with contextlib.ExitStack() as opened:
        devices: dict[DeviceKind, Any] = dict.fromkeys(DEVICE_KINDS)
        for kind, opener in openers.items():
            try:
                devices[kind] = opener()
            except CtrError as error:
                raise OpenError(f"devices.{kind}: {error}") from None
            except (Exception, SystemExit) as error:  # an installed driver can raise anything
                raise OpenError(f"devices.{kind}: {type(error).__name__}: {error}") from error
            opened.callback(devices[kind].close)
        opened.pop_all()
        return Devices(**devices)
