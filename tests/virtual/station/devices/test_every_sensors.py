"""Contract of all drivers of force sensors, checked on simulated sensors in virtual time: the same tests for each.

The drivers are those of the registry; a driver without a bench fails.
"""

import math
import select
import time
from itertools import pairwise

import numpy as np
import pytest

from station.devices.interfaces import Condition, Severity, WrenchReading
from station.devices.registry import BUILT_IN_DRIVERS, INTERFACES
from tests.harness.sensor_benches import BENCHES, WRENCHES, SensorBench

#: Longest time from the last good sample to a reading that is not usable: 50 ms, a tick and the latency [s].
STALE_S = 0.055
#: Time in which a sensor is usable again after its fault has ended [s].
RECOVERY_S = 1.0


@pytest.fixture(params=list(BENCHES))
def unconnected(request: pytest.FixtureRequest) -> SensorBench:
    return BENCHES[request.param]()


@pytest.fixture
def bench(unconnected: SensorBench) -> SensorBench:
    unconnected.sensors.connect(0.0)
    unconnected.run(0.5)
    assert unconnected.sensors.condition is Condition.CONNECTED, unconnected.sensors.trouble(unconnected.now)
    assert unconnected.sensors.trouble(unconnected.now) is None
    return unconnected


def check_finite(readings: list[tuple[float, WrenchReading]]) -> None:
    """Check that readings are finite, of the right shape, in the order of their times and not from the future."""
    assert all(r.wrenches.shape == (2, 6) and np.isfinite(r.wrenches).all() for _, r in readings)
    assert all(math.isfinite(r.time) and r.time <= now for now, r in readings)
    assert all(a.time <= b.time for (_, a), (_, b) in pairwise(readings))


def check_hold(bench: SensorBench, faulty: int) -> None:
    """Check for a HOLD that names one sensor and no other."""
    fault = bench.sensors.trouble(bench.now)
    assert fault is not None
    assert fault.severity is Severity.HOLD
    assert f"force sensor {faulty + 1}" in fault.text
    assert f"force sensor {2 - faulty}" not in str(fault)
    assert bench.names[faulty] in fault.details
    assert "nan" not in str(fault)


def check_usable(bench: SensorBench) -> None:
    bench.run(RECOVERY_S)
    check_finite(found := bench.run(0.1))
    assert all(reading.usable for _, reading in found)
    assert found[-1][1].wrenches == pytest.approx(WRENCHES, abs=1e-5)
    assert bench.sensors.trouble(bench.now) is None
    assert bench.sensors.condition is Condition.CONNECTED


def test_every_driver_of_force_sensors_has_a_bench_here():
    assert set(BENCHES) == set(BUILT_IN_DRIVERS["sensors"])


def test_sensors_have_the_methods_of_the_interface_and_are_not_usable_before_they_are_connected(unconnected):
    sensors = unconnected.sensors
    assert all(hasattr(sensors, name) for name in dir(INTERFACES["sensors"]) if not name.startswith("_"))
    assert sensors.condition is Condition.CLOSED
    reading = sensors.poll(0.0)
    check_finite([(0.0, reading)])
    assert not reading.usable
    assert sensors.details()
    assert sensors.trouble(0.0).severity is Severity.HOLD


def test_sensors_without_samples_stay_connecting_with_a_finite_reading(unconnected):
    unconnected.silence(1, True)
    unconnected.sensors.connect(0.0)
    check_finite(found := unconnected.run(0.5))
    assert not any(reading.usable for _, reading in found)
    assert unconnected.sensors.condition is Condition.CONNECTING
    check_hold(unconnected, 1)


@pytest.mark.parametrize("seconds", [0.3, 2.6, 9.0])
def test_sensor_that_starts_late_is_waited_for(unconnected, seconds):
    unconnected.silence(0, True)
    unconnected.sensors.connect(0.0)
    unconnected.run(seconds)
    check_hold(unconnected, 0)
    unconnected.silence(0, False)
    check_usable(unconnected)


def test_readings_are_finite_in_order_and_the_true_wrenches(bench):
    check_finite(found := bench.run(2.0))
    assert all(reading.usable for _, reading in found)
    assert found[-1][1].wrenches == pytest.approx(WRENCHES, abs=1e-5)
    assert all(now - reading.time < 0.02 for now, reading in found)
    assert len({reading.time for _, reading in found}) > 0.4 * len(found)


def test_changed_wrench_is_measured_within_20_ms(bench):
    bench.run(0.02, 2.0 * WRENCHES)
    assert bench.run(0.002, 2.0 * WRENCHES)[0][1].wrenches == pytest.approx(2.0 * WRENCHES, abs=1e-5)


@pytest.mark.parametrize("sensor", [0, 1])
def test_silent_sensor_is_not_usable_within_its_bound_keeps_its_wrench_and_recovers(bench, sensor):
    bench.silence(sensor, True)
    found = bench.run(0.5)
    check_finite(found)
    since = found[0][0]
    assert all(not reading.usable for now, reading in found if now - since > STALE_S)
    assert all(reading.usable for now, reading in found if now - since < 0.04)
    assert found[-1][1].wrenches == pytest.approx(WRENCHES, abs=1e-5)
    check_hold(bench, sensor)
    bench.silence(sensor, False)
    check_usable(bench)


@pytest.mark.parametrize("sensor", [0, 1])
def test_saturated_sample_is_flagged_never_enters_the_reading_and_the_sensor_recovers(bench, sensor):
    bench.saturate(sensor, True)
    found = bench.run(0.2)
    check_finite(found)
    assert not any(reading.usable for now, reading in found[10:])
    assert all(reading.wrenches == pytest.approx(WRENCHES, abs=1e-5) for _, reading in found)
    check_hold(bench, sensor)
    assert "saturated" in bench.sensors.trouble(bench.now).text
    bench.saturate(sensor, False)
    check_usable(bench)


@pytest.mark.parametrize("sensor", [0, 1])
def test_cut_line_is_a_hold_within_the_bound_and_ends_after_the_line_is_mended(bench, sensor):
    bench.cut(sensor)
    check_finite(found := bench.run(0.2))
    assert not found[-1][1].usable
    assert found[-1][1].wrenches == pytest.approx(WRENCHES, abs=1e-5)
    check_hold(bench, sensor)
    bench.sensors.connect(bench.now)
    check_finite(found := bench.run(0.2))
    assert not found[-1][1].usable
    assert bench.sensors.trouble(bench.now).severity is Severity.HOLD
    bench.mend(sensor)
    bench.sensors.connect(bench.now)
    check_usable(bench)


def test_poll_neither_sleeps_nor_waits_for_data(bench, monkeypatch):
    def waits(*_: object) -> None:
        raise AssertionError("the driver waits")

    monkeypatch.setattr(time, "sleep", waits)
    monkeypatch.setattr(select, "select", waits)
    bench.run(0.1)
    bench.silence(0, True)
    bench.run(0.7)


def test_sensors_can_be_closed_twice_also_after_a_cut_line(bench):
    bench.cut(0)
    bench.run(0.1)
    bench.sensors.close()
    bench.sensors.close()
