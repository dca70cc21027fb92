"""Faults of a simulated Net F/T box on the wire, and what the real driver makes of them."""

import struct

import numpy as np
import pytest

from station.devices.netft.page import read_page
from station.devices.netft.sensors import NetftSensors, Quality
from station.lab.netft.wire import MOST_WAITING
from tests.harness.netft_bench import STREAM, TICK, WRENCH, Bench


class Station(Bench):
    """The driver of one sensor at the host's end."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        self.sensors = NetftSensors([self.host], [read_page(self.box.page() or b"")])
        self.sensors.start(0.0)
        self.worst = Quality.GOOD

    def drive(self, time: float, wrench: np.ndarray = WRENCH) -> np.ndarray:
        self.worst = Quality.GOOD
        for _ in range(round(time / TICK)):
            self.now += TICK
            self.box.advance(self.now, wrench)
            reading = self.sensors.poll(self.now)
            self.worst |= self.sensors.quality[0]
            if self.sensors.is_usable:
                assert reading.wrenches[0] == pytest.approx(wrench, abs=1e-6)
                assert self.now - 0.05 < reading.time <= self.now
        return reading.wrenches[0]


@pytest.fixture
def station() -> Station:
    station = Station()
    station.drive(0.1)
    assert station.sensors.is_usable
    return station


def test_the_driver_reads_what_the_plant_has(station):
    assert station.drive(1.0) == pytest.approx(WRENCH, abs=1e-6)
    assert station.worst is Quality.GOOD
    assert station.sensors.counters[0].lost == 0


def test_lost_doubled_and_exchanged_datagrams_are_counted_and_used_all_the_same(station):
    station.box.faults.drop = station.box.faults.duplicate = station.box.faults.reorder = 0.1
    station.drive(2.0)

    counters = station.sensors.counters[0]
    assert station.worst == Quality.GAP
    assert counters.lost > 50
    assert counters.duplicates > 50
    assert counters.late > 50
    assert counters.resyncs == 0


def test_flipped_bits_do_not_upset_the_stream(station):
    station.box.faults.flip = 0.2
    for _ in range(1000):  # bits of the counts themselves are for UDP's checksum
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)
    station.box.faults.flip = 0.0
    station.drive(0.1)

    assert station.sensors.quality == (Quality.GOOD,)
    assert station.sensors.counters[0].implausible > 10


@pytest.mark.parametrize(
    ("fault", "value", "quality"),
    [
        ("mute", True, Quality.STALE),
        ("saturate", True, Quality.SATURATED),
        ("freeze", True, Quality.STALE),
        ("status", 1 << 9, Quality.STATUS),
    ],
)
def test_a_fault_is_seen_as_what_it_is_and_goes_when_it_goes(station, fault, value, quality):
    healthy = getattr(station.box.faults, fault)
    setattr(station.box.faults, fault, value)
    station.drive(0.5)
    assert quality in station.worst
    assert not station.sensors.is_usable

    setattr(station.box.faults, fault, healthy)
    station.drive(1.0)
    assert station.sensors.is_usable


def test_a_delay_makes_old_samples_of_old_time(station):
    station.box.faults.delay = 0.020
    for _ in range(100):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        reading = station.sensors.poll(station.now)

    assert station.sensors.is_usable
    assert station.now - reading.time == pytest.approx(0.020, abs=0.004)


def test_a_box_without_power_for_a_moment_is_not_trusted_again_by_itself(station):
    station.drive(5.0)
    station.box.reboot()
    for _ in range(1000):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)

    assert Quality.RESET in station.sensors.quality[0]
    assert not station.sensors.is_usable
    station.sensors.start(station.now)
    station.drive(0.1)
    assert station.sensors.is_usable


def test_records_that_nobody_receives_do_not_pile_up():
    bench = Bench(rate=7000.0)
    bench.ask(STREAM)
    for _ in range(1000):
        bench.now += TICK
        bench.box.advance(bench.now, WRENCH)

    newest = [struct.unpack(">I", datagram[:4])[0] for datagram in bench.host.receive()]
    assert len(newest) == MOST_WAITING
    assert newest == list(range(newest[-1] - MOST_WAITING + 1, newest[-1] + 1))
