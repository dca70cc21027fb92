"""A station file with devices of its own: checked before anything starts."""

import pytest

from station.config.strict import OWN_EXPERIMENTS, ConfigError, preset_names
from station.control.clock import REAL_TIME, StationClock
from station.devices.config import BenchFile
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES


def test_without_devices_it_is_the_virtual_lab(write):
    for text in ("", 'devices = "virtual"\n'):
        bench = load_station(write(text)).bench()
        assert bench.devices is None
        assert bench.title == bench.lab.title


def test_with_devices_it_is_a_bench_and_says_so(write):
    bench = load_station(write(OWN_DEVICES)).bench()
    assert isinstance(bench.devices, BenchFile)
    assert bench.title == "bench of 'paper': zaber, aurora, netft"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"zaber"', '"newport"', r"own.toml: devices.stages.driver = 'newport' is not one of zaber"),
        ('port = "/dev/ttyUSB1"', "", r"own.toml: devices.tracker: 'port' is missing"),
        ("tubes.outer", "tubes.middle", r"own.toml: devices.sensors.tubes.middle: the robot has no such part"),
        ("[devices.tracker]", "[devices.camera]", r"own.toml: unknown key 'devices.camera'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_file(write, old, new, told):
    with pytest.raises(ConfigError, match=told):
        load_station(write(OWN_DEVICES.replace(old, new))).bench()


def test_a_station_keeps_real_time_unless_its_file_says_otherwise(write):
    bench = load_station(write("")).bench()
    assert bench.clock == REAL_TIME
    assert not any("real time" in warning for warning in bench.warnings)


def test_a_slow_clock_is_a_warning(write):
    bench = load_station(write("[clock]\nrate = 0.25\n")).bench()
    assert bench.clock == StationClock(0.25)
    assert "not in real time: this station's clock goes at 0.25 of it (clock.rate)" in bench.warnings


def test_real_devices_cannot_be_made_slower(write):
    with pytest.raises(ConfigError, match=r"own.toml: clock.rate = 0.5: expected 1 with devices of one's own"):
        load_station(write(OWN_DEVICES + "[clock]\nrate = 0.5\n")).bench()
    assert load_station(write(OWN_DEVICES + "[clock]\nrate = 1.0\n")).bench().clock == REAL_TIME


@pytest.mark.parametrize("rate", ["0.01", "1.5", "nan", "0"])
def test_a_clock_that_is_too_slow_or_too_fast_is_refused(write, rate):
    with pytest.raises(ConfigError, match=r"own.toml.*clock.rate"):
        load_station(write(f"[clock]\nrate = {rate}\n"))


def test_a_folder_of_experiments_is_beside_the_file(monkeypatch, write, tmp_path):
    monkeypatch.setenv(OWN_EXPERIMENTS, "")  # put back after the test
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "hold_still.toml").write_text("", encoding="utf-8")
    load_station(write('[experiments]\nfolder = "mine"\n', "station"))

    assert "hold_still" in preset_names("experiments")
    with pytest.raises(ConfigError, match="elsewhere: no such folder of experiments"):
        load_station(write('[experiments]\nfolder = "elsewhere"\n', "station"))


def test_what_the_command_line_says_goes_before_the_file(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text('lab = "ideal"\nseed = 4\n', encoding="utf-8")

    bench = load_station(path, {"lab": "uncalibrated"}).bench()

    assert (bench.lab.title[:12], bench.seed) == ("uncalibrated", 4)
    with pytest.raises(ConfigError, match="no such folder"):
        load_station(None, {"calibration": str(tmp_path / "nope")}).bench()
    with pytest.raises(ConfigError, match="'nowhere' is not one of the labs"):
        load_station(path, {"lab": "nowhere"}).bench()


@pytest.mark.parametrize(("said", "means"), [("go_on", "continue"), ("hold", "hold")])
def test_the_word_of_earlier_versions_for_a_lost_operator_is_understood(write, said, means):
    assert load_station(write(f"alone = '{said}'\n")).bench().on_operator_loss == means


def test_nobody_is_told_two_words_for_a_lost_operator(write):
    with pytest.raises(ConfigError, match="alone"):
        load_station(write("alone = 'hold'\non_operator_loss = 'continue'\n"))
