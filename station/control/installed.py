"""Devices of installed drivers: what such a driver raises, and how long the loop waits for it, is told by its name.

The station's own drivers never raise and never wait; they are left as they are.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

from core.errors import CtrError
from station.control.clock import StationClock
from station.control.ring import CALLED, Ring
from station.devices.config import BenchFile
from station.devices.interfaces import Devices
from station.devices.open_devices import KINDS
from station.devices.registry import BUILT_IN

#: A call that takes longer is worth telling [s].
LONG = 0.01


class DriverError(CtrError):
    """An installed driver has raised something; names the driver, its method and what it was."""


class Calls:
    """Of installed drivers by the loop: which one is on, and which was the longest."""

    def __init__(self, ring: Ring, clock: StationClock) -> None:
        self._ring, self._clock = ring, clock
        self._longest = (0.0, "")

    def call(self, place: int, driver: str, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call a method of the device at that place of `KINDS`; raises DriverError."""
        begun = self._clock.now()
        self._ring.counters[CALLED] = place + 1
        try:
            return method(*arguments)
        except CtrError as error:
            if name == "home":
                raise  # stages may refuse that
            raise DriverError(f"{driver}: {name} raised {error}") from error
        except Exception as error:  # whatever an installed driver does
            raise DriverError(f"{driver}: {name} raised {type(error).__name__}: {error}") from error
        finally:
            self._ring.counters[CALLED] = 0
            self._longest = max(self._longest, (self._clock.now() - begun, f"{driver}: {name}"))

    def longest(self) -> str:
        """The longest call since the last question, in words; empty if it was not long."""
        (took, what), self._longest = self._longest, (0.0, "")
        return f"{what} took {took:.3f} s" if took > LONG else ""


def called(ring: Ring, bench: BenchFile) -> str:
    """The driver that the loop is just waiting for, if it is an installed one; empty if not."""
    place = int(ring.counters[CALLED]) - 1
    return _named(place, bench) if place >= 0 else ""


def named(devices: Devices, bench: BenchFile, calls: Calls) -> Devices:
    """The devices, those of installed drivers watched."""
    watched = {
        kind: getattr(devices, kind)
        if getattr(bench, kind)["driver"] in BUILT_IN[kind]
        else cast("Any", _Installed(getattr(devices, kind), partial(calls.call, place, _named(place, bench))))
        for place, kind in enumerate(KINDS)
    }
    return Devices(**watched)


def _named(place: int, bench: BenchFile) -> str:
    kind = KINDS[place]
    return f"driver '{getattr(bench, kind)['driver']}' of devices.{kind}"


class _Installed:
    """One of them."""

    def __init__(self, device: Any, call: Callable[..., Any]) -> None:
        self._device, self._call = device, call

    def __getattr__(self, name: str) -> Any:
        value = self._call(name, lambda: getattr(self._device, name))
        return partial(self._call, name, value) if callable(value) else value
