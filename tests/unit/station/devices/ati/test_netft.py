"""The driver of two sensors: one sample from two streams, with its faults as quality."""

import math
import struct

import numpy as np
import pytest

from station.devices.ati.calibration import NetftPage
from station.devices.ati.netft import ForceBoxFile, NetftSensors, SensorError, WrenchQuality, connect, fetch_page
from station.devices.ati.protocol import LATENCY_S, RdtCommand, request
from station.devices.links.link import LinkError
from station.lab.wires import MemoryDatagramEnd

#: Page with the counts of a box whose units are N and N-mm.
PAGE = NetftPage("Net F/T", "FT1", 1e-6, 1e-9, None)
TICK = 0.002


class Box:
    """Simulated Net F/T box: the test controls this end of the link."""

    def __init__(self, name: str, page: NetftPage = PAGE, count: int = 6433) -> None:
        self.end, self.page = MemoryDatagramEnd(), page
        self.link = self.end.link(name)
        self.rdt, self.count = 0, count

    def send(self, time: float, force: float = 0.0, moment: float = 0.0, status: int = 0) -> None:
        """Send one record measured at `time` [s], with a force along x [N] and a moment about z [N m]."""
        self.rdt += 1
        count = self.count + round(7000 * time)
        counts = (round(force * 1e6), 0, 0, 0, 0, round(moment * 1e9))
        self.end.send(struct.pack(">IIIiiiiii", self.rdt, count % 2**32, status, *counts), self.link.address)

    def requests(self) -> list[str]:
        return [request.hex() for request, _ in self.end.receive()]


@pytest.fixture
def boxes() -> list[Box]:
    return [Box("inner"), Box("outer", count=2**32 - 100)]


def driver(boxes: list[Box]) -> NetftSensors:
    sensors = NetftSensors([box.link for box in boxes], [box.page for box in boxes])
    sensors.start(0.0)
    return sensors


def run(sensors: NetftSensors, boxes: list[Box], ticks: range, **what: object) -> None:
    """Send records of every box at every tick, and poll after their arrival."""
    for tick in ticks:
        for box in boxes:
            box.send(tick * TICK, **what)
        sensors.poll(tick * TICK + LATENCY_S)


def test_stream_requests_bias_and_stop_match_the_manual(boxes):
    sensors = driver(boxes)
    for box in boxes:
        box.link.send(request(RdtCommand.BIAS))
        box.link.send(request(RdtCommand.RESET_LATCH))
    sensors.stop()

    for box in boxes:
        assert box.requests() == ["1234000200000000", "1234004200000000", "1234004100000000", "1234000000000000"]


def test_reading_before_the_first_sample_is_stale_and_finite(boxes):
    sensors = driver(boxes)
    reading = sensors.poll(0.01)

    assert np.array_equal(reading.wrenches, np.zeros((2, 6)))
    assert math.isfinite(reading.time)
    assert not sensors.is_usable
    assert sensors.quality == (WrenchQuality.STALE, WrenchQuality.STALE)


def test_two_sensors_give_one_sample_in_si_units(boxes):
    sensors = driver(boxes)
    for tick in range(1, 11):
        boxes[0].send(tick * TICK, force=1.5, moment=0.1)
        boxes[1].send(tick * TICK, force=-2.5, moment=-0.2)
        reading = sensors.poll(tick * TICK + LATENCY_S)

    assert reading.wrenches == pytest.approx(np.array([[1.5, 0, 0, 0, 0, 0.1], [-2.5, 0, 0, 0, 0, -0.2]]))
    assert reading.time == pytest.approx(0.020, abs=1e-4)
    assert sensors.is_usable
    assert sensors.quality == (WrenchQuality.GOOD, WrenchQuality.GOOD)
    assert sensors.complaint() == ""


def test_newer_sensor_is_interpolated_at_the_time_of_the_older(boxes):
    sensors = driver(boxes)
    for tick in range(1, 51):
        boxes[0].send(tick * TICK, force=tick * TICK)
        sensors.poll(tick * TICK + LATENCY_S)
        boxes[1].send(tick * TICK + 0.001, force=tick * TICK + 0.001)  # box 1 measures 1 ms later than box 0
        reading = sensors.poll(tick * TICK + 0.001 + LATENCY_S)

    # Both forces rise by 1 N/s, so at a common time both values in N equal this time in s.
    assert reading.time == pytest.approx(0.100, abs=1e-4)
    assert reading.wrenches[:, 0] == pytest.approx([0.100, 0.100], abs=1e-4)


def test_poll_without_new_records_returns_the_last_sample(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    first, second = sensors.poll(0.021), sensors.poll(0.022)

    assert np.array_equal(first.wrenches, second.wrenches)
    assert first.time == second.time == pytest.approx(0.020, abs=1e-4)
    assert sensors.is_usable


def test_silent_sensor_is_stale_is_requested_again_and_recovers(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    for box in boxes:
        box.requests()
    kept = sensors.poll(0.069)
    assert sensors.is_usable
    kept = sensors.poll(0.072)

    assert not sensors.is_usable
    assert kept.wrenches[:, 0] == pytest.approx([1.0, 1.0])
    for tick in range(40, 1040):  # 2 s
        sensors.poll(tick * TICK)
    assert [len(box.requests()) for box in boxes] == [4, 4]  # one request every half second

    for box in boxes:
        box.rdt = 0
    run(sensors, boxes, range(1040, 1044), force=2.0)
    assert sensors.quality == (WrenchQuality.GOOD, WrenchQuality.GOOD)
    assert sensors.poll(2.1).wrenches[:, 0] == pytest.approx([2.0, 2.0])


def test_silent_sensor_does_not_delay_the_other_one(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    run(sensors, boxes[:1], range(11, 111), force=3.0)
    reading = sensors.poll(0.221)

    assert sensors.quality == (WrenchQuality.GOOD, WrenchQuality.STALE)
    assert reading.wrenches[:, 0] == pytest.approx([3.0, 1.0])
    assert reading.time == pytest.approx(0.220, abs=1e-4)
    assert "force sensor 2 on outer: stale" in sensors.complaint()


@pytest.mark.parametrize(
    ("what", "quality"),
    [
        ({"status": 0x80020000, "force": 18.0}, WrenchQuality.SATURATED),
        ({"status": 0x80000004, "force": 5.0}, WrenchQuality.STATUS),
        ({"status": 0x80030000, "force": 5.0}, WrenchQuality.SATURATED),
        ({"force": 18.1}, WrenchQuality.RANGE),
        ({"moment": -0.2501}, WrenchQuality.RANGE),
        ({"force": -2147.0}, WrenchQuality.RANGE),
    ],
)
def test_unusable_sample_never_changes_the_reading(boxes, what, quality):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    for tick in range(11, 15):
        boxes[0].send(tick * TICK, **what)
        boxes[1].send(tick * TICK, force=1.0)
        reading = sensors.poll(tick * TICK + LATENCY_S)

        assert sensors.quality == (quality, WrenchQuality.GOOD)
        assert not sensors.is_usable
        assert reading.wrenches[0] == pytest.approx([1.0, 0, 0, 0, 0, 0])
    run(sensors, boxes, range(15, 16), force=2.0)
    assert sensors.is_usable


def test_bad_sample_among_good_ones_of_one_poll_is_reported(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    for tick, status in ((11, 0), (12, 0x80020000), (13, 0)):
        for box in boxes:
            box.send(tick * TICK, force=1.0, status=status)
    sensors.poll(13 * TICK + LATENCY_S)

    assert sensors.quality == (WrenchQuality.SATURATED, WrenchQuality.SATURATED)


def test_complaint_contains_the_text_of_a_bad_status(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), status=0x80020000)

    assert "transducer saturated or A/D" in sensors.complaint()


def test_latched_threshold_is_a_warning(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0, status=0x80010000)

    assert sensors.quality == (WrenchQuality.LATCHED, WrenchQuality.LATCHED)
    assert sensors.is_usable


def test_gap_is_reported_once_as_a_warning(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11))
    boxes[0].rdt += 3
    run(sensors, boxes, range(14, 15))
    boxes[1].rdt += 3

    assert sensors.quality[0] == WrenchQuality.GAP
    assert sensors.is_usable
    assert sensors.counters[0].lost == 3
    run(sensors, boxes[:1], range(15, 16))
    assert sensors.quality[0] == WrenchQuality.GOOD


def test_restarted_box_is_not_used_until_the_operator_starts_it(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 501), force=1.0)
    boxes[0].rdt, boxes[0].count = 0, -10_000  # the box has restarted: its counter is reset, and its bias is lost
    run(sensors, boxes, range(501, 601), force=3.0)

    assert sensors.quality[0] == WrenchQuality.RESET
    assert not sensors.is_usable
    sensors.start(1.2)
    run(sensors, boxes, range(601, 610), force=3.0)
    assert sensors.is_usable


def test_lost_link_is_reported_as_quality_without_an_exception(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    boxes[0].link.close()
    reading = sensors.poll(0.021)

    assert sensors.quality[0] == WrenchQuality.GONE
    assert reading.wrenches[:, 0] == pytest.approx([1.0, 1.0])
    for tick in range(11, 1000):
        sensors.poll(tick * TICK)
    assert sensors.quality[0] == WrenchQuality.GONE | WrenchQuality.STALE
    sensors.close()
    with pytest.raises(LinkError):
        boxes[1].link.receive()


def test_range_of_the_page_overrides_the_configured_one():
    box = Box("inner", NetftPage("Net F/T", "FT1", 1e-6, 1e-9, (9.0,) * 3 + (0.125,) * 3))
    sensors = driver([box])
    run(sensors, [box], range(1, 11), force=9.5)

    assert sensors.quality == (WrenchQuality.RANGE | WrenchQuality.STALE,)


def test_time_of_the_reading_never_decreases(boxes):
    sensors, times, rng = driver(boxes), [], np.random.default_rng(1)
    for tick in range(1, 2000):
        for box in boxes:
            box.send(tick * TICK)
        times.append(sensors.poll(tick * TICK + LATENCY_S + rng.uniform(0.0, 0.0019)).time)

    assert (np.diff(times[5:]) >= 0.0).all()


def test_address_without_an_answer_is_named():
    with pytest.raises(SensorError, match=r"http://127\.0\.0\.1:9/netftapi2\.xml does not answer"):
        fetch_page("127.0.0.1", 9, timeout=0.5)
    with pytest.raises(SensorError, match="does not answer"):
        connect([ForceBoxFile(host="127.0.0.1", http_port=9)])
