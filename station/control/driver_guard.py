"""Guards for custom code in the control process: installed drivers and custom control loops.

Errors and slow calls are reported with the name of the driver or loop. Built-in drivers and loops never raise and never
wait, so the control process calls them without a guard.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from core.contract import name_of
from core.control.controller_settings import Controller
from core.control.controllers import LoopInputs, Strategy, VelocityTask
from core.control.trajectories import Setpoint
from core.errors import CtrError
from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.ring import DRIVER_IN_CALL, Ring
from station.devices.config import BenchFile
from station.devices.guard import DriverError, GuardedDriver, joint_reading, tip_reading, wrench_reading
from station.devices.interfaces import Devices
from station.devices.registry import BUILT_IN_DRIVERS, DEVICE_KINDS, DeviceKind

#: Duration of a call to custom code [s], above which the call is named as a likely cause of a late tick.
SLOW_CALL_S = 0.5 * PERIOD_S
#: Numbers that identify a custom outer or inner loop in the ring's counter; the devices of `DEVICE_KINDS` come first.
OUTER, INNER = len(DEVICE_KINDS), len(DEVICE_KINDS) + 1


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

    def reset(self) -> None:
        """Reset the state of the loop, if it has one."""
        if (reset := getattr(self._loop, "reset", None)) is not None:
            reset()

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
    # Count once, because the functions below run in every tick.
    counts = {"stages": len(robot.joints), "tracker": 0, "sensors": len(robot.sensor_names)}

    def watched(index: int, kind: DeviceKind) -> Any:
        device = devices.by_kind.get(kind)
        if device is None or getattr(bench, kind)["driver"] in BUILT_IN_DRIVERS[kind]:
            return device
        count, polled = counts[kind], _POLLED[kind]
        return GuardedDriver(
            device, _guarded(index, bench), partial(calls.call, index), lambda value: polled(value, count)
        )

    return Devices(*(watched(index, kind) for index, kind in enumerate(DEVICE_KINDS)))


def _guarded(index: int, bench: BenchFile) -> str:
    kind = DEVICE_KINDS[index]
    return f"driver '{getattr(bench, kind)['driver']}' of devices.{kind}"


#: Functions that check the result of `poll`, given the number of joints or force sensors.
_POLLED: dict[DeviceKind, Callable[[Any, int], Any]] = {
    "stages": joint_reading, "tracker": lambda value, _: tip_reading(value), "sensors": wrench_reading,
}  # fmt: skip
