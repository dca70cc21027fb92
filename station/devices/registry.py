"""Finds drivers by name and opens the devices of a bench; if one cannot be opened, all are closed again.

A driver is built in, or installed with an entry point `ctr_station.devices`. An installed driver is a callable
`open(options, robot)` that returns a device with an interface of `interfaces.py`. `options` is the device's table of
the station file without the key `driver`. If the callable raises, the station opens no device. A callable for stages
has an attribute `emergency_stop(options, robot, clock)`, a function by which another process stops the stages. It may
have an attribute `latency(options, robot)`, a function that returns the latency of the stages without opening them.
"""

import contextlib
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

from core.errors import CtrError
from station.config.controllers import StagesLatency
from station.config.plugins import load
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.ati.netft import netft
from station.devices.ati.nidaq import nidaq
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.aurora.tracker import aurora
from station.devices.cia402.stages import CIA402
from station.devices.config import BenchFile
from station.devices.gcode.stages import GCODE
from station.devices.interfaces import BaseSensors, DeviceKind, Devices, EmergencyStop, Stages, Tracker
from station.devices.kernel.driver import StagesDriver
from station.devices.stereo.tracker import stereo
from station.devices.zaber.stages import ZABER, line_latency
from station.devices.zaber_ascii.stages import ZABER_ASCII

ENTRY_POINT_GROUP = "ctr_station.devices"

DEVICE_KINDS: tuple[DeviceKind, ...] = ("stages", "tracker", "sensors")
#: Function that opens a device whose options have been checked.
Opener = Callable[[], Any]
#: Function that checks the options of a device and returns the device's opener.
Driver = Callable[[Mapping[str, Any], RobotFile], Opener]

INTERFACES: dict[DeviceKind, type] = {"stages": Stages, "tracker": Tracker, "sensors": BaseSensors}
STAGES_DRIVERS: dict[str, StagesDriver] = {"zaber": ZABER, "zaber_ascii": ZABER_ASCII, "cia402": CIA402, "gcode": GCODE}
BUILT_IN_DRIVERS: dict[DeviceKind, dict[str, Driver]] = {
    "stages": {name: driver.open for name, driver in STAGES_DRIVERS.items()},
    "tracker": {"aurora": aurora, "stereo": stereo},
    "sensors": {"netft": netft, "nidaq": nidaq},
}


def default_latency(tracker: str) -> float:
    """Return the latency that a tracker's driver uses without the key `latency` [s]; 0 for an installed driver."""
    return AuroraSettings.latency if tracker == "aurora" else 0.0


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
    where, opens = ("", STAGES_DRIVERS[name]) if name in STAGES_DRIVERS else _loaded("stages", name)
    if isinstance(opens, StagesDriver):
        return opens.emergency_stop(options, robot)
    stop: Any = getattr(opens, "emergency_stop", None)
    if stop is not None and not callable(stop):
        raise ConfigError(f"{where}: its emergency_stop is not a callable emergency_stop(options, robot, clock)")
    return None if stop is None else cast(EmergencyStop, partial(cast(Any, stop), options, robot))


def stages_latency(stages: Mapping[str, Any], robot: RobotFile) -> StagesLatency:
    """Return the latency of the stages in `[devices.stages]`, from the driver's options; no device is opened.

    For an installed driver without the attribute `latency`, return the latency of Zaber T-series stages on one line.

    Raises:
        ConfigError: an option is invalid, or the latency of an installed driver is not two times of 0 ... 1 s.
    """
    options = dict(stages)
    name = options.pop("driver")
    if name in STAGES_DRIVERS:
        return STAGES_DRIVERS[name].latency(options, robot)
    where, opens = _loaded("stages", name)
    latency: Any = getattr(opens, "latency", None)
    if latency is None:
        return line_latency(len(robot.joints))
    try:
        found = StagesLatency(*map(float, latency(options, robot)))
    except CtrError:
        raise
    except Exception as error:  # a foreign function can raise anything
        raise ConfigError(f"{where}: its latency function raised {type(error).__name__}: {error}") from error
    if not all(math.isfinite(value) and 0.0 <= value <= 1.0 for value in found):
        raise ConfigError(f"{where}: its latency is {tuple(found)} s; expected interval and delay within 0 ... 1 s")
    return found


def _loaded(kind: DeviceKind, name: str) -> tuple[str, Callable[..., Any]]:
    """Return a description of an installed driver, for messages, and the driver's callable."""
    where, opens = load(ENTRY_POINT_GROUP, name, f"devices.{kind}.driver", tuple(BUILT_IN_DRIVERS[kind]))
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
        options = {key: value for key, value in table.items() if key != "at" or kind != "sensors"}
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
