"""The driver of two sensors: one sample from two streams, with its faults as quality."""

import re
import struct
from contextlib import closing
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Timer

import numpy as np
import pytest

from station.devices.ati.calibration import NetftPage
from station.devices.ati.netft import ForceBoxFile, NetftSensors, SensorError, check_identities, connect, fetch_page
from station.devices.ati.protocol import LATENCY_S
from station.devices.interfaces import Severity
from station.devices.kernel.quality import Quality
from station.lab.simulated_netft import BoxSettings, SimulatedNetft
from station.lab.wires import MemoryDatagramEnd
from tests.harness.netft_bench import PERFECT
from tests.unit.station.devices.ati.test_calibration import page

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


def test_driver_sends_a_stream_request_and_a_stop_as_in_the_manual(boxes):
    driver(boxes).stop()
    for box in boxes:
        assert box.requests() == ["1234000200000000", "1234000000000000"]


def test_two_sensors_give_one_sample_in_si_units(boxes):
    sensors = driver(boxes)
    for tick in range(1, 11):
        boxes[0].send(tick * TICK, force=1.5, moment=0.1)
        boxes[1].send(tick * TICK, force=-2.5, moment=-0.2)
        reading = sensors.poll(tick * TICK + LATENCY_S)

    assert reading.wrenches == pytest.approx(np.array([[1.5, 0, 0, 0, 0, 0.1], [-2.5, 0, 0, 0, 0, -0.2]]))
    assert reading.time == pytest.approx(0.020, abs=1e-4)
    assert sensors.is_usable
    assert sensors.quality == (Quality.GOOD, Quality.GOOD)
    assert sensors.trouble(0.020) is None


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
    assert sensors.quality == (Quality.GOOD, Quality.GOOD)
    assert sensors.poll(2.1).wrenches[:, 0] == pytest.approx([2.0, 2.0])


def test_silent_sensor_does_not_delay_the_other_one(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    run(sensors, boxes[:1], range(11, 111), force=3.0)
    reading = sensors.poll(0.221)

    assert sensors.quality == (Quality.GOOD, Quality.STALE | Quality.SILENT)
    assert reading.wrenches[:, 0] == pytest.approx([3.0, 1.0])
    assert reading.time == pytest.approx(0.220, abs=1e-4)
    fault = sensors.trouble(0.221)
    assert fault is not None
    assert fault.text == "force sensor 2 was silent for 0.20 s"
    assert fault.details == "force sensor 2 on outer: silent, stale"


@pytest.mark.parametrize(
    ("what", "quality"),
    [
        ({"status": 0x80020000, "force": 18.0}, Quality.SATURATED),
        ({"status": 0x80000004, "force": 5.0}, Quality.DEVICE_FAULT),
        ({"status": 0x80030000, "force": 5.0}, Quality.SATURATED),
        ({"force": 18.1}, Quality.RANGE),
        ({"moment": -0.2501}, Quality.RANGE),
        ({"force": -2147.0}, Quality.RANGE),
    ],
)
def test_unusable_sample_never_changes_the_reading(boxes, what, quality):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0)
    for tick in range(11, 15):
        boxes[0].send(tick * TICK, **what)
        boxes[1].send(tick * TICK, force=1.0)
        reading = sensors.poll(tick * TICK + LATENCY_S)

        assert sensors.quality == (quality, Quality.GOOD)
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

    assert sensors.quality == (Quality.SATURATED, Quality.SATURATED)


def test_latched_threshold_is_a_warning(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11), force=1.0, status=0x80010000)

    assert sensors.quality == (Quality.LATCHED, Quality.LATCHED)
    assert sensors.is_usable


def test_gap_is_reported_once_as_a_warning(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 11))
    boxes[0].rdt += 3
    run(sensors, boxes, range(14, 15))
    boxes[1].rdt += 3

    assert sensors.quality[0] == Quality.GAP
    assert sensors.is_usable
    assert sensors.counters[0].lost == 3
    run(sensors, boxes[:1], range(15, 16))
    assert sensors.quality[0] == Quality.GOOD


def test_restarted_box_is_not_used_until_the_operator_starts_it(boxes):
    sensors = driver(boxes)
    run(sensors, boxes, range(1, 501), force=1.0)
    boxes[0].rdt, boxes[0].count = 0, -10_000  # the box has restarted: its counter is reset, and its bias is lost
    run(sensors, boxes, range(501, 601), force=3.0)

    assert sensors.quality[0] == Quality.RESTARTED
    assert not sensors.is_usable
    sensors.start(1.2)
    run(sensors, boxes, range(601, 610), force=3.0)
    assert sensors.is_usable


def test_range_of_the_page_overrides_the_configured_one():
    box = Box("inner", NetftPage("Net F/T", "FT1", 1e-6, 1e-9, (9.0,) * 3 + (0.125,) * 3))
    sensors = driver([box])
    run(sensors, [box], range(1, 11), force=9.5)

    assert sensors.quality == (Quality.RANGE | Quality.STALE,)


def test_time_of_the_reading_never_decreases(boxes):
    sensors, times, rng = driver(boxes), [], np.random.default_rng(1)
    for tick in range(1, 2000):
        for box in boxes:
            box.send(tick * TICK)
        times.append(sensors.poll(tick * TICK + LATENCY_S + rng.uniform(0.0, 0.0019)).time)

    assert (np.diff(times[5:]) >= 0.0).all()


@pytest.mark.parametrize("rate", [3.0, 25.0, 49.0])
def test_slow_stream_is_a_hold_with_its_rate_and_the_setting_to_change(rate):
    box = SimulatedNetft(end := MemoryDatagramEnd(), PERFECT, np.random.default_rng(0), BoxSettings(rate=rate))
    sensors = NetftSensors([end.link("box")], [PAGE])
    sensors.start(0.0)
    for tick in range(1, 1000):
        box.advance(tick * TICK, np.zeros(6))
        sensors.poll(tick * TICK)
    fault = sensors.trouble(2.0)

    assert not sensors.is_usable
    assert fault is not None
    assert fault.severity is Severity.HOLD
    expected = f"force sensor 1 sends {rate:.3g} records/s, at least 50 are needed: set the RDT rate on its page"
    assert fault.text == expected


@pytest.mark.parametrize("rate", [50.0, 100.0, 7000.0])
def test_stream_of_a_sufficient_rate_is_usable(rate):
    box = SimulatedNetft(end := MemoryDatagramEnd(), PERFECT, np.random.default_rng(0), BoxSettings(rate=rate))
    sensors = NetftSensors([end.link("box")], [PAGE])
    sensors.start(0.0)
    usable = []
    for tick in range(1, 1000):
        box.advance(tick * TICK, np.zeros(6))
        usable.append(sensors.poll(tick * TICK).usable)

    assert all(usable[100:])


def test_box_whose_counter_runs_at_another_rate_is_a_warning_with_both_rates(boxes):
    sensors = driver(boxes)
    for tick in range(1, 5000):
        for box in boxes:
            box.count = -round(7000 * tick * TICK) + 16 * tick  # 8000 counts/s
            box.send(tick * TICK)
        sensors.poll(tick * TICK + LATENCY_S)
    fault = sensors.trouble(10.0)

    assert sensors.is_usable
    assert fault is not None
    assert fault.severity is Severity.WARN
    assert re.search(r"force sensor 1 counts (7[89]|8[01])\d\d samples/s instead of 7000", fault.text)


def test_datagrams_of_another_device_are_quoted_with_what_was_expected(boxes):
    sensors = driver(boxes)
    for tick in range(1, 100):
        boxes[0].end.send(b"HELLO", boxes[0].link.address)
        boxes[1].send(tick * TICK)
        sensors.poll(tick * TICK)
    fault = sensors.trouble(0.2)

    assert sensors.quality == (Quality.STALE | Quality.UNREADABLE, Quality.GOOD)
    assert fault is not None
    assert fault.text == "force sensor 1 sends 'HELLO', expected records of 36 bytes: check 'host' and 'rdt_port'"


def test_a_force_box_at_two_addresses_is_refused_with_both_tubes():
    boxes = [ForceBoxFile(host="192.168.1.11"), ForceBoxFile(host="box.lan")]
    with pytest.raises(SensorError, match=r"at 192\.168\.1\.11:49152 and box\.lan:49152 have the same calibration"):
        check_identities(boxes, [PAGE, PAGE])
    check_identities(boxes, [replace(PAGE, serial="")] * 2)  # old boxes report none


def test_page_of_a_box_that_starts_late_is_waited_for():
    class Box(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(page())

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Box, bind_and_activate=False)
    server.server_bind()
    starts = Timer(0.3, lambda: (server.server_activate(), server.handle_request()))
    starts.start()
    with closing(server.socket):
        assert fetch_page("127.0.0.1", server.server_address[1]).product == "Net F/T"
        starts.join()


def test_address_without_an_answer_is_named():
    with pytest.raises(SensorError, match=r"http://127\.0\.0\.1:9/netftapi2\.xml does not answer"):
        fetch_page("127.0.0.1", 9, timeout=0.5, attempts=0)
    with pytest.raises(SensorError, match="does not answer"):
        connect([ForceBoxFile(host="127.0.0.1", http_port=9)], attempts=0)
