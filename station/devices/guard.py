"""Guard around an installed driver: checks its results; errors name the driver, the method and the value.

The control process and `check-driver` use the same guard, so both accept the same results.
"""

import pickle
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from core.contract import numbers
from core.errors import ContractError, CtrError
from station.devices.interfaces import Condition, DeviceFault, JointReading, Severity, TipReading, WrenchReading


class DriverError(CtrError):
    """An installed driver raised, or returned an invalid value; the text names driver, method and value."""


class GuardedDriver:
    """Guard around an installed driver: its methods receive copies of arrays; results are copied and checked."""

    def __init__(self, device: Any, driver: str, call: Callable[..., Any], poll: Callable[[Any], Any]) -> None:
        self._device, self._driver, self._call = device, driver, call
        self._checks = {**_RESULTS, "poll": poll}

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


def joint_reading(value: Any, joints: int) -> JointReading:
    """Return a checked reading of the stages. NaN is accepted, because the control loop reports NaN and enters HOLD."""
    shape = (joints,)
    positions, sent = _fields(value, JointReading)
    return JointReading(
        numbers("JointReading", "positions", positions, shape, "rad or m", finite=False),
        numbers("JointReading", "sent", sent, shape, "rad/s or m/s"),
    )


def tip_reading(value: Any) -> TipReading | None:
    """Return a checked frame of the tracker, or None."""
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


def wrench_reading(value: Any, tubes: int) -> WrenchReading:
    """Return a checked sample of the base sensors."""
    time, wrenches, usable = _fields(value, WrenchReading)
    wrenches = numbers("WrenchReading", "wrenches", wrenches, (tubes, 6), "N, N m", finite=False)
    return WrenchReading(_time("WrenchReading", time), wrenches, _flag(usable))


def _fields(value: Any, reading: type) -> tuple[Any, ...]:
    if not isinstance(value, reading):
        raise ContractError(f"it must be a {reading.__name__}")
    return tuple(value)


def _time(who: str, value: Any) -> float:
    return float(numbers(who, "time", value, (), "s"))


_PROPERTIES = ("condition", "ready")
#: Functions that check the results of a driver's methods and properties, except `poll`; other methods return nothing.
_RESULTS: Mapping[str, Callable[[Any], Any]] = {
    "condition": Condition,
    "ready": _flag,
    "trouble": _trouble,
    "details": _details,
}
