"""Checks of the configuration file of a station before any process starts."""

import pytest

from station.config.strict import EXPERIMENTS_VARIABLE, ConfigError, preset_names
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.devices.config import BenchFile
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES


def test_station_file_without_devices_uses_the_virtual_lab(write):
    for text in ("", 'devices = "virtual"\n'):
        bench = load_station(write(text)).bench()
        assert bench.devices is None
        assert bench.title == bench.lab.title


def test_station_file_with_devices_has_the_title_of_a_bench(write):
    bench = load_station(write(OWN_DEVICES)).bench()
    assert isinstance(bench.devices, BenchFile)
    assert bench.title == "bench of 'paper': zaber, aurora, netft"


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('"zaber"', '"newport"', r"own.toml: devices.stages.driver = 'newport' is not one of zaber"),
        ('port = "/dev/ttyUSB1"', "", r"own.toml: devices.tracker: 'port' is missing"),
        ("tubes.outer", "tubes.middle", r"own.toml: devices.sensors.tubes.middle: the robot has no such part"),
        ("[devices.tracker]", "[devices.camera]", r"own.toml: unknown key 'devices.camera'"),
    ],
)
def test_error_for_invalid_devices_names_the_station_file(write, old, new, error):
    with pytest.raises(ConfigError, match=error):
        load_station(write(OWN_DEVICES.replace(old, new))).bench()


def test_station_runs_in_real_time_by_default(write):
    bench = load_station(write("")).bench()
    assert bench.clock == REAL_TIME_CLOCK
    assert not any("real time" in warning for warning in bench.warnings)


def test_slow_clock_causes_a_warning(write):
    bench = load_station(write("[clock]\nrate = 0.25\n")).bench()
    assert bench.clock == StationClock(0.25)
    assert "not in real time: this station's clock runs at 0.25 times real time (clock.rate)" in bench.warnings


def test_slow_clock_is_refused_with_real_devices(write):
    with pytest.raises(ConfigError, match=r"own.toml: clock.rate = 0.5: expected 1 with real devices"):
        load_station(write(OWN_DEVICES + "[clock]\nrate = 0.5\n")).bench()
    assert load_station(write(OWN_DEVICES + "[clock]\nrate = 1.0\n")).bench().clock == REAL_TIME_CLOCK


def test_patience_sets_missing_deadlines_of_stages_and_sensors(write):
    without, patient, own = (
        load_station(write(text)).bench().devices
        for text in (
            OWN_DEVICES,
            OWN_DEVICES + "[clock]\npatience = 0.25\n",
            OWN_DEVICES.replace('driver = "zaber"', 'driver = "zaber"\ndeadline = 0.06') + "[clock]\npatience = 0.25\n",
        )
    )
    assert "deadline" not in without.stages
    assert "stale_after" not in without.sensors
    assert (patient.stages["deadline"], patient.sensors["stale_after"]) == (0.25, 0.25)
    assert (own.stages["deadline"], own.sensors["stale_after"]) == (0.06, 0.25)


@pytest.mark.parametrize("rate", ["0.01", "1.5", "nan", "0"])
def test_clock_rate_out_of_range_is_refused(write, rate):
    with pytest.raises(ConfigError, match=r"own.toml.*clock.rate"):
        load_station(write(f"[clock]\nrate = {rate}\n"))


def test_folder_of_experiments_is_relative_to_the_station_file(monkeypatch, write, tmp_path):
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")  # pytest restores this variable after the test
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "hold_still.toml").write_text("", encoding="utf-8")
    load_station(write('[experiments]\nfolder = "mine"\n', "station"))

    assert "hold_still" in preset_names("experiments")
    with pytest.raises(ConfigError, match="elsewhere: no such folder of experiments"):
        load_station(write('[experiments]\nfolder = "elsewhere"\n', "station"))


def test_command_line_overrides_the_station_file(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text('lab = "ideal"\nseed = 4\n', encoding="utf-8")

    bench = load_station(path, {"lab": "uncalibrated"}).bench()

    assert (bench.lab.title[:12], bench.seed) == ("uncalibrated", 4)
    with pytest.raises(ConfigError, match="no such folder"):
        load_station(None, {"calibration": str(tmp_path / "nope")}).bench()
    with pytest.raises(ConfigError, match="'nowhere' is not one of the labs"):
        load_station(path, {"lab": "nowhere"}).bench()


@pytest.mark.parametrize(("value", "meaning"), [("go_on", "continue"), ("hold", "hold")])
def test_key_alone_of_earlier_versions_is_read(write, value, meaning):
    assert load_station(write(f"alone = '{value}'\n")).bench().on_operator_loss == meaning


def test_old_and_new_key_for_a_lost_operator_are_refused_together(write):
    with pytest.raises(ConfigError, match="alone"):
        load_station(write("alone = 'hold'\non_operator_loss = 'continue'\n"))
