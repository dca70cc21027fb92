"""Errors and slow calls of custom drivers and loops are reported with their names."""

import math
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from core.control.controllers import PositionMode, Strategy
from core.control.trajectories import Setpoint
from core.errors import CtrError
from station.config.controllers import DEFAULT_CONTROLLER, PERIOD_S
from station.config.robots import load_robot
from station.control.clock import REAL_TIME_CLOCK
from station.control.driver_guard import SLOW_CALL_S, DriverCalls, driver_in_call, guard_drivers
from station.control.monitors import OverrunLimits, Overruns
from station.control.ring import Ring
from station.devices.config import BenchFile
from station.devices.guard import DriverError
from station.devices.interfaces import Condition, Devices, JointReading, Severity, TipReading, WrenchReading

PAPER = load_robot("paper")
BENCH = BenchFile(stages={"driver": "line-stages"}, tracker={"driver": "aurora"}, sensors={"driver": "netft"})


class Stages:
    """Custom stages that implement only a part of the interface."""

    condition = Condition.CONNECTED

    def __init__(self, ring: Ring) -> None:
        self.seen = ""
        self._ring = ring

    @property
    def ready(self) -> bool:
        raise KeyError("ready")

    def home(self, now: float) -> None:
        raise CtrError("these stages need no homing")

    def poll(self, now: float) -> Any:
        raise ZeroDivisionError("division by zero")

    def command(self, velocities: Any, now: float) -> None:
        self.seen = driver_in_call(self._ring, BENCH)
        REAL_TIME_CLOCK.sleep(2.0 * SLOW_CALL_S)


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring(1)
    yield ring
    ring.close(remove=True)


def test_error_of_a_custom_driver_names_driver_method_and_exception(ring: Ring) -> None:
    stages = guard_drivers(Devices(Stages(ring), None, None), BENCH, DriverCalls(ring, REAL_TIME_CLOCK), PAPER).stages

    with pytest.raises(
        DriverError, match=r"driver 'line-stages' of devices\.stages: poll raised ZeroDivisionError: div"
    ):
        stages.poll(0.0)
    with pytest.raises(DriverError, match="ready raised KeyError"):
        _ = stages.ready
    assert stages.condition is Condition.CONNECTED
    with pytest.raises(CtrError) as refused:
        stages.home(0.0)
    assert not isinstance(refused.value, DriverError)  # a refusal to home is no error of the driver


def test_slow_custom_driver_is_named_during_and_after_its_call(ring: Ring) -> None:
    device, calls = Stages(ring), DriverCalls(ring, REAL_TIME_CLOCK)
    stages = guard_drivers(Devices(device, None, None), BENCH, calls, PAPER).stages
    stages.command(np.zeros(3), 0.0)

    assert device.seen == "driver 'line-stages' of devices.stages"
    assert driver_in_call(ring, BENCH) == ""
    assert calls.longest().startswith("driver 'line-stages' of devices.stages: command took ")
    assert calls.longest() == ""


def test_built_in_drivers_are_not_guarded(ring: Ring) -> None:
    own = BenchFile(stages={"driver": "zaber"}, tracker={"driver": "aurora"}, sensors={"driver": "netft"})
    stages = Stages(ring)
    assert guard_drivers(Devices(stages, None, None), own, DriverCalls(ring, REAL_TIME_CLOCK), PAPER).stages is stages


class Returning:
    """Device whose methods all return or raise the same value."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def poll(self, now: float) -> Any:
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value

    trouble = details = poll

    @property
    def condition(self) -> Any:
        return self.poll(0.0)

    ready = condition


ALL_INSTALLED = BenchFile(stages={"driver": "a"}, tracker={"driver": "b"}, sensors={"driver": "c"})
ARRAYS = arrays.arrays(
    dtype=st.sampled_from([np.float64, np.float32, np.int64, np.complex128, np.bool_, object]),
    shape=st.one_of(st.sampled_from([(3,), (2, 6)]), arrays.array_shapes(min_dims=0, max_dims=2, min_side=0)),
)
NUMBERS = st.one_of(ARRAYS, st.floats(), st.none(), st.text(max_size=3))
VALUES = st.one_of(
    NUMBERS, st.lists(st.floats(), max_size=3), st.just(lambda: None), st.just({"a": lambda: None}),
    st.just(KeyError("x")), st.just(SystemExit(1)), st.booleans(), st.integers(),
    st.builds(JointReading, NUMBERS, NUMBERS), st.builds(TipReading, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS),
    st.builds(WrenchReading, NUMBERS, NUMBERS, st.one_of(st.booleans(), NUMBERS)),
    st.builds(JointReading, arrays.arrays(np.float64, 3), arrays.arrays(np.float64, 3)),
    st.builds(WrenchReading, st.floats(), arrays.arrays(np.float64, (2, 6)), st.booleans()),
    st.builds(TipReading, st.integers(), st.floats(), arrays.arrays(np.float64, 3)),
)  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@example(value=JointReading(np.zeros(2), np.zeros(3)))
@example(value=JointReading(np.zeros(3), 0.0))  # type: ignore[arg-type]
@example(value=TipReading(1, 0.0, np.zeros((3, 1))))
@example(value=WrenchReading(0.0, np.zeros(12)))
@given(value=VALUES)
def test_invalid_result_of_a_custom_driver_causes_an_error_that_names_the_driver(ring: Ring, value: Any) -> None:
    device = Returning(value)
    devices = guard_drivers(Devices(device, device, device), ALL_INSTALLED, DriverCalls(ring, REAL_TIME_CLOCK), PAPER)  # type: ignore[arg-type]
    results: dict[str, Callable[[], Any]] = {
        "stages": lambda: devices.stages.poll(0.0), "tracker": lambda: devices.tracker.poll(0.0),
        "sensors": lambda: devices.sensors.poll(0.0), "condition": lambda: devices.stages.condition,
        "ready": lambda: devices.stages.ready, "trouble": lambda: devices.stages.trouble(0.0),
        "details": lambda: devices.stages.details(),
    }  # fmt: skip
    for what, result in results.items():
        try:
            found = result()
        except DriverError as error:
            assert "driver '" in str(error)  # noqa: PT017 - or else the reading
            continue
        match what:
            case "stages":
                assert found.positions.shape == found.sent.shape == (3,)
                assert found.positions.dtype == found.sent.dtype == np.float64
            case "tracker" if found is not None:
                assert found.position.shape == (3,)
                assert math.isfinite(found.time)
            case "sensors":
                assert found.wrenches.shape == (2, 6)
                assert isinstance(found.usable, bool)
            case "condition":
                assert isinstance(found, Condition)
            case "ready":
                assert isinstance(found, bool)
            case "trouble":
                assert found is None or isinstance(found.severity, Severity)
            case "details":
                assert pickle.dumps(found)


class Slow(PositionMode):
    """A custom loop that takes longer than a period."""

    def tip_velocity(self, setpoint: Any, tip: Any) -> Any:
        REAL_TIME_CLOCK.sleep(2.0 * PERIOD_S)
        return np.zeros(3)


def test_slow_custom_loop_is_named_as_the_cause_of_late_ticks(ring: Ring) -> None:
    usual, calls = DEFAULT_CONTROLLER.controller(PAPER), DriverCalls(ring, REAL_TIME_CLOCK)
    assert calls.watched(usual) is usual
    timed = calls.watched(replace(usual, strategy=Strategy(Slow(2.5, 2.5), usual.strategy.inner))).strategy
    timed.tip_velocity(Setpoint(np.zeros(3), np.zeros(3)), np.zeros(3))
    slow, overruns = calls.longest(), Overruns(OverrunLimits(), PERIOD_S)

    assert slow.startswith("outer loop 'Slow' took ")
    late = [overruns.check(PERIOD_S * tick, 1, slow) for tick in range(5)][-1]
    assert late is not None
    assert "outer loop 'Slow' took " in late.text
    assert "other programs" not in late.text
