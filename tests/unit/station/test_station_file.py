"""A station file with devices of its own: checked before anything starts."""

import pytest

from station.config import OWN_EXPERIMENTS, ConfigError, preset_names
from station.devices.config import BenchFile
from station.station_file import load_station

DEVICES = """
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"
[devices.sensors]
driver = "netft"
tubes.inner.host = "192.168.1.11"
tubes.outer.host = "192.168.1.12"
"""


def test_without_devices_it_is_the_virtual_lab(write):
    for text in ("", 'devices = "virtual"\n'):
        bench = load_station(write(text)).bench()
        assert bench.devices is None
        assert bench.title == bench.lab.title


def test_with_devices_it_is_a_bench_and_says_so(write):
    bench = load_station(write(DEVICES)).bench()
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
        load_station(write(DEVICES.replace(old, new))).bench()


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
