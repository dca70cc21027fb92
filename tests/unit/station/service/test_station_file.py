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


def test_error_for_invalid_devices_names_the_station_file(write):
    with pytest.raises(ConfigError, match=r"own.toml: devices.stages.driver = 'newport' is not one of zaber"):
        load_station(write(OWN_DEVICES.replace('"zaber"', '"newport"'))).bench()


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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", (0.025, 0.012)),
        ('lab = { stages = "cia402" }\n', (0.004, 0.00063)),
        ('lab = { stages = "cia402" }\n[controller]\ntransport_delay = 0.003\n', (0.004, 0.003)),
        (OWN_DEVICES.replace('"zaber"', '"cia402"'), (0.004, 0.00063)),
    ],
)
def test_controller_of_a_station_plans_for_the_latency_of_its_stages(write, text, expected):
    rig = load_station(write(text)).bench()
    actuation = rig.controlled(rig.controller).estimator.actuation
    assert (actuation.command_interval, actuation.transport_delay) == pytest.approx(expected)


def test_gateway_origins_are_those_that_a_browser_sends(write):
    origins = ("http://localhost:8080", "https://lab.example", "http://192.168.1.7:3000", "http://[::1]:8080")
    assert load_station(write("")).gateway_origins == ()
    assert load_station(write(f"gateway_origins = {list(origins)}\n")).gateway_origins == origins


@pytest.mark.parametrize(
    "origin",
    ["*", "http://*", "http://*.example", "null", "", "localhost:8080", "http://localhost:8080/", "http://a:0", "http://a:x",
     "http://a:65536", "http://a:080", "http://a:80", "https://a:443", "http://A:8080", "ftp://a", "http://u@a", "http://a..b",
     "http://a:8080\\n"],
)  # fmt: skip
def test_an_origin_that_no_browser_sends_is_refused(origin, write):
    with pytest.raises(ConfigError, match=r"gateway_origins.0 = .*: expected http or https, host and optional port"):
        load_station(write(f'gateway_origins = ["{origin}"]\n'))


def test_a_lab_with_one_force_sensor_gives_the_robot_of_its_station(write, tmp_path):
    for at, measured in (("robot", True), ("inner", False)):
        (tmp_path / "lab.toml").write_text(f'[sensors]\nat = "{at}"\n', encoding="utf-8")
        rig = load_station(write('lab = "lab.toml"\n')).bench()
        assert rig.robot.sensor_names == rig.best_known_robot.sensor_names == (at,)
        assert rig.present.sensors == measured
        assert any("tube 'inner' alone" in text for text in rig.warnings) != measured
    (tmp_path / "lab.toml").write_text('[sensors]\nat = "plate"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"at of the lab = 'plate': expected 'tubes' .* 'robot' .* inner, outer"):
        load_station(write('lab = "lab.toml"\n')).bench()
