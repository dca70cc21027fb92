"""Opens all devices of a bench, or none of them."""

import contextlib

from core.errors import CtrError
from station.config.robots import RobotFile
from station.devices.config import BenchFile
from station.devices.interfaces import Devices
from station.devices.registry import DeviceKind, Opener, find

DEVICE_KINDS: tuple[DeviceKind, ...] = ("stages", "tracker", "sensors")


class OpenError(CtrError):
    """A device cannot be opened; the text names its table in the station file, its port and what to do."""


def plan(bench: BenchFile, robot: RobotFile) -> dict[DeviceKind, Opener]:
    """Check the configuration, and return an opener for each device; no device is opened yet.

    Raises:
        ConfigError: an invalid key; the text names the key, the value and what was expected.
    """
    openers: dict[DeviceKind, Opener] = {}
    for kind in DEVICE_KINDS:
        options = dict(getattr(bench, kind))
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
        devices = []
        for kind in DEVICE_KINDS:
            try:
                devices.append(openers[kind]())
            except CtrError as error:
                raise OpenError(f"devices.{kind}: {error}") from None
            except (Exception, SystemExit) as error:  # an installed driver can raise anything
                raise OpenError(f"devices.{kind}: {type(error).__name__}: {error}") from error
            opened.callback(devices[-1].close)
        opened.pop_all()
        return Devices(*devices)
