"""Sensors on analog cards; the voltages come from arrays instead of a converter."""

import importlib.util
import math
import sys
from collections.abc import Sequence

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.devices.ati.nidaq import CardSensors, NiCard, Wiring, device_of, nidaq
from station.devices.interfaces import Condition, Severity
from station.devices.links.link import LinkError, PortLock
from tests.harness.recorded_card import CALIBRATION, MATRIX, TICK, Recorded, voltages_of
from tests.unit.station.devices.ati.test_calibration import AXIS_ROWS, file

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


@pytest.mark.parametrize(
    ("inputs", "serials", "message"),
    [
        (["Dev1/ai0:5", "Dev1/ai0:5"], ["FT1", "FT2"], "tubes.outer.channels: inner has the same value 'Dev1/ai0:5'"),
        (["Dev1/ai0:5", "Dev1/ai6:11"], ["FT1", "FT1"], "tubes.outer.calibration: inner has the same value 'FT1'"),
    ],
)
def test_two_tubes_with_one_sensor_are_refused_with_both(tmp_path, paper, inputs, serials, message):
    for k, serial in enumerate(serials):
        (tmp_path / f"{k}.cal").write_bytes(file(AXIS_ROWS).replace(b"FT9999", serial.encode()))
    tubes = {
        tube.name: {"channels": channels, "calibration": str(tmp_path / f"{k}.cal")}
        for k, (tube, channels) in enumerate(zip(paper.tubes, inputs, strict=True))
    }
    with pytest.raises(ConfigError, match=message):
        nidaq({"tubes": tubes}, paper)


def sensors_on(cards: Sequence[Recorded], wirings: Sequence[Wiring]) -> CardSensors:
    return CardSensors(lambda: cards, wirings)


def test_mean_of_ten_samples_has_a_tenth_of_the_noise_power():
    noise = 1e-3 * np.random.default_rng(2).normal(size=(6, 20_000))
    singles = MATRIX @ noise
    means = np.array([CALIBRATION.mean_wrench(noise[:, k : k + 10]) for k in range(0, 20_000, 10)])
    assert means.std(axis=0) == pytest.approx(singles.std(axis=1) / math.sqrt(10.0), rel=0.05)


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


def test_card_that_samples_slower_than_it_reports_is_a_warning_with_both_rates():
    card = Recorded("Dev1", np.repeat(voltages_of(np.zeros(6))[:, None], 60_000, axis=1))
    sensors = sensors_on([card], [Wiring(0, 0, CALIBRATION)])
    sensors.connect(0.0)
    for tick in range(1, 5000):
        card.now = 0.8 * tick * TICK
        sensors.poll(tick * TICK)
    fault = sensors.trouble(tick * TICK)

    assert fault is not None
    assert fault.severity is Severity.WARN
    assert fault.text == "force sensor 1 sends 4000 samples/s; its card reports 5000"
