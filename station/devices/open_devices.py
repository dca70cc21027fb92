"""All devices of a bench, opened together or not at all."""

import contextlib

from core.errors import CtrError
from station.config.robots import RobotFile
from station.devices.config import BenchFile
from station.devices.interfaces import Devices
from station.devices.registry import DeviceKind, Opener, find

KINDS: tuple[DeviceKind, ...] = ("stages", "tracker", "sensors")


class OpenError(CtrError):
    """A device that cannot be opened; names its table of the station file, its port and what to do."""


def plan(bench: BenchFile, robot: RobotFile) -> dict[DeviceKind, Opener]:
    """How to open each device; nothing is opened yet.

    Raises:
        ConfigError: with the key, the value and what was expected.
    """
    openers: dict[DeviceKind, Opener] = {}
    for kind in KINDS:
        told = dict(getattr(bench, kind))
        openers[kind] = find(kind, told.pop("driver"))(told, robot)
    return openers


def open_devices(bench: BenchFile, robot: RobotFile) -> Devices:
    """Open every device of a bench; `connect` is still to come. It may wait for a box's page.

    Raises:
        ConfigError: as `plan`.
        OpenError: one cannot be opened; those that were are closed again.
    """
    openers = plan(bench, robot)
    with contextlib.ExitStack() as opened:
        devices = []
        for kind in KINDS:
            try:
                devices.append(openers[kind]())
            except CtrError as error:
                raise OpenError(f"devices.{kind}: {error}") from None
            except Exception as error:  # whatever an installed driver does
                raise OpenError(f"devices.{kind}: {type(error).__name__}: {error}") from error
            opened.callback(devices[-1].close)
        opened.pop_all()
        return Devices(*devices)
