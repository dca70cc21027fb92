"""Guards for custom code in the control process: installed drivers and custom control loops.

Errors and slow calls are reported with the name of the driver or loop. Built-in drivers and loops never raise and never
wait, so the control process calls them without a guard.
"""

import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from core.contract import name_of, numbers
from core.control.controller_settings import Controller
from core.control.controllers import LoopInputs, Strategy, VelocityTask
from core.control.trajectories import Setpoint
from core.errors import ContractError, CtrError
from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.ring import DRIVER_IN_CALL, Ring
from station.devices.config import BenchFile
from station.devices.interfaces import (
    Condition,
    DeviceFault,
    Devices,
    JointReading,
    Severity,
    TipReading,
    WrenchReading,
)
from station.devices.registry import BUILT_IN_DRIVERS, DEVICE_KINDS, DeviceKind

#: Duration of a call to custom code [s], above which the call is named as a likely cause of a late tick.
SLOW_CALL_S = 0.5 * PERIOD_S
#: Numbers that identify a custom outer or inner loop in the ring's counter; the devices of `DEVICE_KINDS` come first.
OUTER, INNER = len(DEVICE_KINDS), len(DEVICE_KINDS) + 1


class DriverError(CtrError):
    """An installed driver raised, or returned an invalid value; the text names driver, method and value."""


class DriverCalls:
    """Record of the loop's calls to custom code: the call in progress, and the longest call of the present tick."""

    def __init__(self, ring: Ring, clock: StationClock) -> None:
        self._ring, self._clock = ring, clock
        self._longest = (0.0, "")

    def timed(self, index: int, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of `function`; the ring's counter shows `index` during the call."""
        start = self._clock.now()
        self._ring.counters[DRIVER_IN_CALL] = index + 1
        try:
            return function(*arguments)
        finally:
            self._ring.counters[DRIVER_IN_CALL] = 0
            self._longest = max(self._longest, (self._clock.now() - start, what))

    def call(self, index: int, driver: str, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call a method of the device at `index` of `DEVICE_KINDS`.

        Raises:
            DriverError: the method raised.
        """
        try:
            return self.timed(index, f"{driver}: {name}", method, *arguments)
        except CtrError as error:
            if name == "home":
                raise  # stages may refuse to home, which is no error of the driver
            raise DriverError(f"{driver}: {name} raised {error}") from error
        except BaseException as error:  # an installed driver may raise anything, even SystemExit
            raise DriverError(f"{driver}: {name} raised {type(error).__name__}: {error}") from error

    def watched(self, controller: Controller) -> Controller:
        """Return the controller with timing around its custom loops; built-in loops stay as they are."""
        strategy = controller.strategy
        if strategy.laws is not None:
            return controller
        outer, inner = strategy.names
        timed = Strategy(
            _Loop(strategy.outer, partial(self.timed, OUTER, outer)),
            _Loop(strategy.inner, partial(self.timed, INNER, inner)),
        )
        return replace(controller, strategy=timed)

    def longest(self) -> str:
        """Return a text about the longest call since the previous `longest()`; empty if that call was not slow."""
        (took, what), self._longest = self._longest, (0.0, "")
        return f"{what} took {1e3 * took:.1f} ms of a period of {1e3 * PERIOD_S:g} ms" if took > SLOW_CALL_S else ""


class _Loop:
    """Custom outer or inner control loop whose calls are timed."""

    def __init__(self, loop: Any, call: Callable[..., Any]) -> None:
        self.__name__ = name_of(loop)
        self._loop, self._call = loop, call

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Call the custom outer loop; see `OuterLoop.tip_velocity`."""
        return self._call(self._loop.tip_velocity, setpoint, tip)

    def __call__(self, u_int: Array, view: LoopInputs, /) -> VelocityTask:
        """Call the custom inner loop; see `InnerLoop`."""
        return self._call(self._loop, u_int, view)


def driver_in_call(ring: Ring, bench: BenchFile) -> str:
    """Return the name of the custom code that the control loop is waiting for; empty if it waits for none."""
    index = int(ring.counters[DRIVER_IN_CALL]) - 1
    if index in (OUTER, INNER):
        return f"the controller's custom {'outer' if index == OUTER else 'inner'} loop"
    return _guarded(index, bench) if index >= 0 else ""


def guard_drivers(devices: Devices, bench: BenchFile, calls: DriverCalls, robot: RobotFile) -> Devices:
    """Return the devices, with guards around those of installed drivers."""

    def watched(index: int, kind: DeviceKind) -> Any:
        device = devices.by_kind.get(kind)
        if device is None or getattr(bench, kind)["driver"] in BUILT_IN_DRIVERS[kind]:
            return device
        return _GuardedDriver(
            device, _guarded(index, bench), partial(calls.call, index), lambda value: _POLLED[index](value, robot)
        )

    return Devices(*(watched(index, kind) for index, kind in enumerate(DEVICE_KINDS)))


def _guarded(index: int, bench: BenchFile) -> str:
    kind = DEVICE_KINDS[index]
    return f"driver '{getattr(bench, kind)['driver']}' of devices.{kind}"


class _GuardedDriver:
    """Guard around an installed driver: its methods receive copies of arrays; results are copied and checked."""

    def __init__(self, device: Any, driver: str, call: Callable[..., Any], poll: Callable[[Any], Any]) -> None:
        self._device, self._driver, self._call = device, driver, call
        self._checks = {**_CHECKS, "poll": poll}

    def __getattr__(self, name: str) -> Any:
        value = self._call(self._driver, name, lambda: getattr(self._device, name))
        if name in _PROPERTIES:  # check the type: a method in place of this property would count as true
            return self._checked(name, value)
        if not callable(value):
            raise DriverError(f"{self._driver}: {name} must be a method; it is a {type(value).__name__}")
        return partial(self._method, name, value)

    def _method(self, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        copies = (one.copy() if isinstance(one, np.ndarray) else one for one in arguments)
        return self._checked(name, self._call(self._driver, name, method, *copies))

    def _checked(self, name: str, value: Any) -> Any:
        check = self._checks.get(name)
        try:
            return value if check is None else check(value)
        except (Exception, SystemExit) as error:  # an installed driver may return anything
            what = f"{self._driver}: {name} returned a wrong value"
            raise DriverError(f"{what}, {type(value).__name__}: {type(error).__name__}: {error}") from error


def _flag(value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise ContractError("it must be a bool")
    return bool(value)


def _trouble(value: Any) -> DeviceFault | None:
    if value is None:
        return None
    fault = DeviceFault(*value)  # `details` may be missing
    if not isinstance(fault.text, str) or not isinstance(fault.details, str):
        raise ContractError("its text and details must be str")
    return fault._replace(severity=Severity(fault.severity))


def _details(value: Any) -> Mapping[str, Any]:
    """Return the checked details of a driver; they must be picklable, because the station process receives them."""
    if not isinstance(value, Mapping):
        raise ContractError("it must be a mapping")
    pickle.dumps(value)
    return value


def _joints(value: Any, robot: RobotFile) -> JointReading:
    """Return a checked reading of the stages. NaN is accepted, because the control loop reports NaN and enters HOLD."""
    shape = (len(robot.joints),)
    positions, sent = _fields(value, JointReading)
    return JointReading(
        numbers("JointReading", "positions", positions, shape, "rad or m", finite=False),
        numbers("JointReading", "sent", sent, shape, "rad/s or m/s"),
    )


def _tip(value: Any, robot: RobotFile) -> TipReading | None:
    del robot  # the check needs no number of joints or tubes: every robot has one tip
    if value is None:
        return None
    frame, time, *vectors = _fields(value, TipReading)
    position, target, direction = (
        None if given is None else numbers("TipReading", what, given, (3,), unit, finite=what != "position")
        for what, given, unit in zip(TipReading._fields[2:], vectors, ("m", "m", "1"), strict=True)
    )
    if position is None:
        raise ContractError("a TipReading without a position must be None")
    return TipReading(int(frame), _time("TipReading", time), position, target, direction)


def _wrenches(value: Any, robot: RobotFile) -> WrenchReading:
    time, wrenches, usable = _fields(value, WrenchReading)
    wrenches = numbers("WrenchReading", "wrenches", wrenches, (len(robot.tubes), 6), "N, N m", finite=False)
    return WrenchReading(_time("WrenchReading", time), wrenches, _flag(usable))


def _fields(value: Any, reading: type) -> tuple[Any, ...]:
    if not isinstance(value, reading):
        raise ContractError(f"it must be a {reading.__name__}")
    return tuple(value)


def _time(who: str, value: Any) -> float:
    return float(numbers(who, "time", value, (), "s"))


_PROPERTIES = ("condition", "ready")
#: Functions that check the result of `poll`, one for each of `DEVICE_KINDS`.
_POLLED: tuple[Callable[[Any, RobotFile], Any], ...] = (_joints, _tip, _wrenches)
#: Functions that check the results of a driver's other methods and properties; other methods return nothing.
_CHECKS: Mapping[str, Callable[[Any], Any]] = {
    "condition": Condition,
    "ready": _flag,
    "trouble": _trouble,
    "details": _details,
}
