"""Contract of all tracker drivers, checked on their simulated devices in virtual time: the same tests for every driver.

The drivers are those of the registry and of the example packages; a driver without a bench fails.
"""

import math
import select
import time
import tomllib
from itertools import pairwise

import numpy as np
import pytest

from core.robot.robot import Array
from station.devices.interfaces import Condition, Severity
from station.devices.registry import BUILT_IN_DRIVERS, ENTRY_POINT_GROUP, INTERFACES
from tests.harness.aurora_bench import REST
from tests.harness.root import ROOT
from tests.harness.tracker_benches import BENCHES, Readings, TrackerBench

#: Time in which every driver has a position after its device was connected, also after a cut line [s].
CONNECT_S = 6.0
#: Time in which measurements that were made before a fault still arrive [s].
IN_TRANSIT_S = 0.1


def circle(now: float) -> Array:
    """Return a position on a circle of 5 mm with a period of 2 s."""
    return REST + 0.005 * np.array([math.cos(math.pi * now) - 1.0, math.sin(math.pi * now), 0.0])


@pytest.fixture(params=list(BENCHES))
def unconnected(request: pytest.FixtureRequest) -> TrackerBench:
    return BENCHES[request.param]()


@pytest.fixture
def bench(unconnected: TrackerBench) -> TrackerBench:
    unconnected.tracker.connect(0.0)
    unconnected.run(1.0)
    assert unconnected.tracker.condition is Condition.CONNECTED, unconnected.tracker.trouble(unconnected.now)
    return unconnected


def check_readings(readings: Readings) -> None:
    """Check that all readings are finite, have increasing numbers and times, and are not from the future."""
    assert readings
    assert all(r.position.shape == (3,) and np.isfinite(r.position).all() for _, r in readings)
    assert all(a.frame < b.frame and a.time < b.time for (_, a), (_, b) in pairwise(readings))
    assert all(now - 0.2 < r.time <= now for now, r in readings)


def check_hold(bench: TrackerBench) -> None:
    fault = bench.tracker.trouble(bench.now)
    assert fault is not None
    assert fault.severity is Severity.HOLD
    assert bench.name in str(fault).lower()


def example_trackers() -> set[str]:
    """Return the names of the example packages' trackers."""
    files = (ROOT / "station/docs/examples").glob("*/pyproject.toml")
    tables = [tomllib.loads(file.read_text(encoding="utf-8"))["project"].get("entry-points", {}) for file in files]
    return {name for table in tables for name in table.get(ENTRY_POINT_GROUP, {}) if name.endswith("tracker")}


def test_every_tracker_driver_has_a_bench_here():
    assert set(BENCHES) == set(BUILT_IN_DRIVERS["tracker"]) | example_trackers()


def test_tracker_has_the_methods_of_the_interface_and_answers_them_before_its_first_frame(unconnected):
    tracker = unconnected.tracker
    assert all(hasattr(tracker, name) for name in dir(INTERFACES["tracker"]) if not name.startswith("_"))
    assert tracker.condition is not Condition.CONNECTED
    tracker.connect(0.0)
    assert tracker.poll(0.0) is None
    assert tracker.condition is Condition.CONNECTING
    assert tracker.details()
    assert tracker.trouble(1.0).severity is Severity.HOLD


def test_tracker_without_frames_stays_connecting_with_a_hold_that_names_it(unconnected):
    unconnected.hide(True)
    unconnected.tracker.connect(0.0)
    assert unconnected.run(1.0) == []
    assert unconnected.tracker.condition is Condition.CONNECTING
    check_hold(unconnected)


def test_frames_are_finite_in_order_and_at_the_true_position_of_their_time(bench):
    readings = bench.run(3.0, circle)
    check_readings(readings)
    assert len(readings) > 60
    # The first readings may be computed from a frame before the jump to the circle; 5 ms at 16 mm/s are 0.08 mm.
    assert max(np.linalg.norm(r.position - circle(r.time)) for _, r in readings[5:]) < 2e-4
    assert bench.tracker.trouble(bench.now) is None


def test_invisible_tip_gives_no_reading_and_a_hold_within_the_bound(bench):
    bench.hide(True)
    last = max((r.time for _, r in bench.run(IN_TRANSIT_S)), default=bench.now - IN_TRANSIT_S)
    assert bench.run(last + bench.bound + 0.05 - bench.now) == []
    check_hold(bench)
    bench.hide(False)
    check_readings(bench.run(0.5))
    assert bench.tracker.trouble(bench.now) is None


def test_short_loss_of_the_tip_is_no_hold(bench):
    bench.hide(True)
    bench.run(0.1)
    fault = bench.tracker.trouble(bench.now)
    assert fault is None or fault.severity is Severity.WARN


def test_repeated_frames_give_no_reading_and_a_hold(bench):
    bench.freeze(True)
    bench.run(IN_TRANSIT_S)
    assert bench.run(1.0) == []
    check_hold(bench)
    bench.freeze(False)
    bench.run(0.5)
    check_readings(bench.run(0.5))
    assert bench.tracker.trouble(bench.now) is None


def test_jump_gives_no_reading_until_it_lasts(bench):
    if not bench.gated:
        pytest.skip("the example driver does not test its positions for jumps")

    def away(_: float) -> Array:
        return REST + np.array([0.05, 0.0, 0.0])

    near = bench.run(0.2, away)
    assert all(np.linalg.norm(r.position - REST) < 1e-3 for _, r in near)
    bench.run(0.5, away)
    check_readings(found := bench.run(0.5, away))
    assert found[-1][1].position == pytest.approx(away(0.0), abs=1e-4)


def test_cut_line_is_a_hold_that_names_the_device_at_once_and_lasts_until_the_line_is_mended(bench):
    bench.cut()
    assert bench.run(0.01) == []
    assert bench.tracker.condition is Condition.FAULT
    check_hold(bench)
    assert bench.run(0.5) == []
    bench.tracker.connect(bench.now)
    bench.run(0.01)
    assert bench.tracker.condition is Condition.FAULT
    check_hold(bench)
    bench.mend()
    bench.tracker.connect(bench.now)
    bench.run(CONNECT_S)
    check_readings(bench.run(0.5))
    assert bench.tracker.condition is Condition.CONNECTED
    assert bench.tracker.trouble(bench.now) is None


@pytest.mark.parametrize("seed", range(3))
def test_random_bytes_give_no_reading_and_no_exception(unconnected, seed):
    random = np.random.default_rng(seed)
    unconnected.hide(True)
    unconnected.tracker.connect(0.0)
    for _ in range(300):
        unconnected.feed(random.bytes(int(random.integers(0, 120))))
        assert unconnected.run(0.01) == []
    assert unconnected.tracker.condition is Condition.CONNECTING


def test_poll_neither_sleeps_nor_waits_for_data(bench, monkeypatch):
    def waits(*_: object) -> None:
        raise AssertionError("the driver waits")

    monkeypatch.setattr(time, "sleep", waits)
    monkeypatch.setattr(select, "select", waits)
    bench.run(0.2)
    bench.hide(True)
    bench.run(0.5)


def test_tracker_can_be_closed_twice_also_after_a_cut_line(bench):
    bench.cut()
    bench.run(0.01)
    bench.tracker.close()
    bench.tracker.close()
