"""Sensors on analog cards; the voltages come from arrays instead of a converter."""

import importlib.util
import math
import sys
from collections.abc import Sequence

import numpy as np
import pytest

from station.devices.ati.calibration import GaugeCalibration
from station.devices.ati.nidaq import CardClock, CardQuality, CardSensors, NiCard, Wiring, device_of
from station.devices.interfaces import Condition, Severity
from station.devices.links.link import LinkError, PortLock

SENSORS = [("Dev1/ai0:5", 10.0)]


def test_missing_package_is_reported_with_the_command_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(LinkError, match=r"Dev1: an NI card needs the package nidaqmx; .*'ctr-station\[nidaq\]'"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


@pytest.mark.skipif(importlib.util.find_spec("nidaqmx") is None, reason="the extra nidaq is not installed")
def test_missing_driver_or_card_names_the_inputs_and_releases_the_lock():
    with pytest.raises(LinkError, match=r"Dev1/ai0:5 cannot be sampled: .*"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


def test_card_is_named_by_its_inputs():
    assert device_of("cDAQ1Mod2/ai0:5") == "cDAQ1Mod2"


RATE = 5000.0
TICK = 0.002
#: Calibration matrix in which every gauge measures every axis, as in real sensors.
MATRIX = np.random.default_rng(1).normal(size=(6, 6)) * np.array([[2.0]] * 3 + [[0.02]] * 3)
CALIBRATION = GaugeCalibration("FT1", "SI-18-0.25", MATRIX, np.array([18.0] * 3 + [0.25] * 3), 10.0)


def voltages_of(wrench: np.ndarray) -> np.ndarray:
    return np.linalg.solve(MATRIX, wrench)


class Recorded:
    """Simulated card that has sampled a recording up to `now`; a read returns the samples since the last read."""

    def __init__(self, name: str, recording: np.ndarray, rate: float = RATE, start: float = 0.0) -> None:
        self.name, self.rate, self.now = name, rate, 0.0
        self._recording, self._start, self._returned = recording, start, 0
        self.broken, self.closed = "", False

    def read(self) -> np.ndarray:
        if self.broken:
            raise LinkError(self.broken)
        # Sample k (from 1) is taken at start + k / rate.
        there = min(max(int((self.now - self._start) * self.rate + 1e-9), self._returned), self._recording.shape[1])
        block, self._returned = self._recording[:, self._returned : there], there
        return block

    def close(self) -> None:
        self.closed = True


def sensors_on(cards: Sequence[Recorded], wirings: Sequence[Wiring]) -> CardSensors:
    return CardSensors(lambda: cards, wirings)


def test_wrench_is_recovered_from_its_voltages():
    wrench = np.array([1.0, -2.0, 3.0, 0.01, 0.02, -0.03])
    samples = np.repeat(voltages_of(wrench)[:, None], 10, axis=1)
    assert CALIBRATION.mean_wrench(samples) == pytest.approx(wrench, abs=1e-12)


def test_mean_of_ten_samples_has_a_tenth_of_the_noise_power():
    noise = 1e-3 * np.random.default_rng(2).normal(size=(6, 20_000))
    singles = MATRIX @ noise
    means = np.array([CALIBRATION.mean_wrench(noise[:, k : k + 10]) for k in range(0, 20_000, 10)])
    assert means.std(axis=0) == pytest.approx(singles.std(axis=1) / math.sqrt(10.0), rel=0.05)


@pytest.mark.parametrize("value", [10.0, -10.0, 12.0, math.nan, math.inf])
def test_saturated_sample_invalidates_the_mean(value):
    samples = np.zeros((6, 10))
    samples[3, 7] = value
    assert CALIBRATION.mean_wrench(samples) is None


def test_sample_time_follows_from_its_number_even_if_read_late():
    random, clock = np.random.default_rng(3), CardClock(RATE)
    count, errors = 0, []
    for tick in range(1, 2000):
        now = tick * TICK + random.exponential(0.5e-3)  # time at which the delayed tick reads the card
        there = int(now * RATE)
        time = clock.middle(there - count, now)
        # This read returns the samples count + 1 ... there. Sample k was taken at k / RATE, so their middle is the mean
        # of the first and the last sample number, divided by RATE.
        errors.append(time - (count + there + 1) / 2.0 / RATE)
        count = there
    # The clock assumes that the least delayed read follows its newest sample at once. That sample may be up to one
    # period (1 / RATE) old, so the computed times may be late by up to one period.
    assert 0.0 <= max(errors[200:]) - 0.0 <= 1.0 / RATE
    assert np.ptp(errors[200:]) < 0.1e-3


def test_card_clock_follows_a_rate_error_of_1e_4():
    for drift in (-1e-4, 1e-4):
        clock, count, time = CardClock(RATE), 0, 0.0
        for tick in range(1, 30_000):  # ticks of one minute
            now = tick * TICK
            there = int(now * RATE * (1.0 + drift))
            time = clock.middle(there - count, now)
            true = (count + there + 1) / 2.0 / RATE / (1.0 + drift)
            count = there
        assert time == pytest.approx(true, abs=1.0e-3 if drift < 0.0 else 0.3e-3)


def test_sensors_on_two_cards_give_one_reading():
    wrenches = np.random.default_rng(4).normal(size=(3, 6)) * np.array([0.2] * 3 + [0.002] * 3)
    volts = [np.repeat(voltages_of(wrench)[:, None], 1000, axis=1) for wrench in wrenches]
    cards = [Recorded("Dev1", np.concatenate(volts[:2])), Recorded("Dev2", volts[2], start=0.0005)]
    sensors = sensors_on(cards, [Wiring(0, 0, CALIBRATION), Wiring(1, 0, CALIBRATION), Wiring(0, 6, CALIBRATION)])
    assert sensors.condition is Condition.CLOSED
    sensors.connect(0.0)
    assert sensors.condition is Condition.CONNECTING
    assert not sensors.poll(0.0).usable
    for tick in range(1, 50):
        for card in cards:
            card.now = tick * TICK
        reading = sensors.poll(tick * TICK)

    assert sensors.condition is Condition.CONNECTED
    assert reading.usable
    assert sensors.trouble(tick * TICK) is None
    assert reading.wrenches == pytest.approx(wrenches[[0, 2, 1]], abs=1e-9)
    assert reading.time == pytest.approx(tick * TICK - 0.5 * TICK, abs=1.0e-3)


def test_saturated_sensor_keeps_its_last_good_wrench_and_is_unusable():
    good = np.repeat(voltages_of(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))[:, None], 2000, axis=1)
    spoilt = good.copy()
    spoilt[2, 500:1000] = 10.0
    cards = [Recorded("Dev1", good), Recorded("Dev2", spoilt)]
    sensors = sensors_on(cards, [Wiring(0, 0, CALIBRATION), Wiring(1, 0, CALIBRATION)])
    sensors.connect(0.0)
    usable, seen = [], []
    for tick in range(1, 200):
        for card in cards:
            card.now = tick * TICK
        reading = sensors.poll(tick * TICK)
        usable.append(reading.usable)
        seen.append(sensors.quality[1])
        assert reading.wrenches[:, 0] == pytest.approx([1.0, 1.0])
        trouble = sensors.trouble(tick * TICK)
        assert (trouble is None) == reading.usable
    assert usable.count(False) == 50
    assert not usable[75]
    assert all(usable[100:])
    assert CardQuality.SATURATED in seen[75]
    assert CardQuality.STALE in seen[98]  # no sample was usable for more than 50 ms


def test_reading_without_new_samples_becomes_stale():
    card = Recorded("Dev1", np.zeros((6, 100)))
    sensors = sensors_on([card], [Wiring(0, 0, CALIBRATION)])
    sensors.connect(0.0)
    card.now = 0.02
    assert sensors.poll(0.02).usable
    assert sensors.poll(0.06).usable
    assert not sensors.poll(0.08).usable
    trouble = sensors.trouble(0.08)
    assert trouble is not None
    assert trouble == (
        Severity.HOLD, "force sensor 1 was silent for too long", "force sensor 1 on Dev1: stale",
    )  # fmt: skip


def test_lost_card_is_reported_and_opened_again():
    cards = [Recorded("Dev1", np.zeros((6, 1000)))]
    opened: list[Recorded] = []

    def opens() -> list[Recorded]:
        if opened and cards[-1] is opened[-1]:
            raise LinkError("Dev1: no such device")
        opened.append(cards[-1])
        return opened[-1:]

    sensors = CardSensors(opens, [Wiring(0, 0, CALIBRATION)])
    sensors.connect(0.0)
    cards[0].now = 0.01
    assert sensors.poll(0.01).usable
    cards[0].broken = "Dev1: the device was unplugged"
    assert not sensors.poll(0.02).usable
    assert sensors.condition is Condition.FAULT
    assert sensors.trouble(0.02) == (
        Severity.HOLD, "force sensor 1 is not connected: its card is lost",
        "force sensor 1 on Dev1: Dev1: the device was unplugged",
    )  # fmt: skip
    assert sensors.details()["1 (Dev1)"]["quality"] == ["gone"]

    sensors.connect(1.0)
    assert cards[0].closed
    assert "no such device" in str(sensors.trouble(1.0))
    cards.append(Recorded("Dev1", np.zeros((6, 1000)), start=1.0))
    sensors.connect(2.0)
    cards[1].now = 2.01
    assert sensors.poll(2.01).usable
    assert sensors.condition is Condition.CONNECTED
