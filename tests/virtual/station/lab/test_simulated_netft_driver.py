"""Faults of a simulated Net F/T box on the wire, and the reaction of the real driver."""

import struct

import numpy as np
import pytest

from station.devices.ati.calibration import read_page
from station.devices.ati.netft import NetftSensors, WrenchQuality
from station.lab.wires import MAX_PENDING_DATAGRAMS
from tests.harness.netft_bench import STREAM, TICK, WRENCH, Bench


class Station(Bench):
    """The driver of one sensor at the host's end."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        self.sensors = NetftSensors([self.host], [read_page(self.box.page() or b"")])
        self.sensors.start(0.0)
        self.worst = WrenchQuality.GOOD

    def drive(self, time: float, wrench: np.ndarray = WRENCH) -> np.ndarray:
        self.worst = WrenchQuality.GOOD
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


def test_netft_driver_reads_the_wrench_of_the_plant(station):
    assert station.drive(1.0) == pytest.approx(WRENCH, abs=1e-6)
    assert station.worst is WrenchQuality.GOOD
    assert station.sensors.counters[0].lost == 0


def test_netft_driver_counts_lost_duplicate_and_swapped_datagrams_and_continues(station):
    station.box.faults.drop = station.box.faults.duplicate = station.box.faults.reorder = 0.1
    station.drive(2.0)

    counters = station.sensors.counters[0]
    assert station.worst == WrenchQuality.GAP
    assert counters.lost > 50
    assert counters.duplicates > 50
    assert counters.late > 50
    assert counters.resyncs == 0


def test_flipped_bits_do_not_stop_the_netft_driver(station):
    station.box.faults.flip = 0.2
    for _ in range(1000):  # UDP's checksum, which this wire lacks, would detect flipped bits of the counts
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)
    station.box.faults.flip = 0.0
    station.drive(0.1)

    assert station.sensors.quality == (WrenchQuality.GOOD,)
    assert station.sensors.counters[0].implausible > 10


@pytest.mark.parametrize(
    ("fault", "value", "quality"),
    [
        ("mute", True, WrenchQuality.STALE),
        ("saturate", True, WrenchQuality.SATURATED),
        ("freeze", True, WrenchQuality.STALE),
        ("status", 1 << 9, WrenchQuality.STATUS),
    ],
)
def test_netft_driver_reports_a_fault_of_the_box_while_it_lasts(station, fault, value, quality):
    healthy = getattr(station.box.faults, fault)
    setattr(station.box.faults, fault, value)
    station.drive(0.5)
    assert quality in station.worst
    assert not station.sensors.is_usable

    setattr(station.box.faults, fault, healthy)
    station.drive(1.0)
    assert station.sensors.is_usable


def test_delayed_force_samples_keep_their_measurement_times(station):
    station.box.faults.delay = 0.020
    for _ in range(100):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        reading = station.sensors.poll(station.now)

    assert station.sensors.is_usable
    assert station.now - reading.time == pytest.approx(0.020, abs=0.004)


def test_netft_driver_does_not_trust_the_box_after_a_power_failure(station):
    station.drive(5.0)
    station.box.reboot()
    for _ in range(1000):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)

    assert WrenchQuality.RESET in station.sensors.quality[0]
    assert not station.sensors.is_usable
    station.sensors.start(station.now)
    station.drive(0.1)
    assert station.sensors.is_usable


def test_number_of_unreceived_netft_records_is_bounded():
    bench = Bench(rate=7000.0)
    bench.request(STREAM)
    for _ in range(1000):
        bench.now += TICK
        bench.box.advance(bench.now, WRENCH)

    newest = [struct.unpack(">I", datagram[:4])[0] for datagram in bench.host.receive()]
    assert len(newest) == MAX_PENDING_DATAGRAMS
    assert newest == list(range(newest[-1] - MAX_PENDING_DATAGRAMS + 1, newest[-1] + 1))
