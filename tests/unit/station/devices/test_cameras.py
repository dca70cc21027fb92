"""The tables of cameras in a station file: valid ones are accepted, and a refusal states what to do."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest

from station.config.strict import ConfigError
from station.service.station_file import load_station


def test_camera_without_keys_is_simulated_and_has_a_view(write: Callable[..., Path]) -> None:
    rig = load_station(write("[cameras.side]\n")).bench()

    camera = rig.cameras["side"]
    assert (camera.simulated, camera.width, camera.height) == (True, 640, 480)
    assert camera.view is not None


def test_usb_camera_has_no_view_before_it_is_calibrated(write: Callable[..., Path]) -> None:
    rig = load_station(write('[cameras.usb]\ndevice = "/dev/v4l/by-id/usb-cam-video-index0"\n')).bench()

    assert rig.cameras["usb"].view is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[cameras.side]\nwidth = 641", r"cameras\.side\.width"),
        ('[cameras.side]\ndevice = "/dev/video0"\nsimulation = { noise = 1.0 }', "the table simulation needs device"),
        ("[cameras.'a b']", r"cameras"),
        ("[cameras.side.lens]\nfocal = [0.0, 1.0]\ncentre = [1.0, 1.0]", r"cameras\.side\.lens\.focal"),
        ("[cameras.side]\ncolour = 1", r"cameras\.side\.colour"),
    ],
)
def test_invalid_camera_is_refused_with_its_key(write: Callable[..., Path], text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_station(write(text)).bench()


def test_simulated_camera_of_real_devices_is_refused(write: Callable[..., Path]) -> None:
    text = """
[cameras.side]

[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
"""
    with pytest.raises(ConfigError, match=r"cameras\.side\.device.*USB camera"):
        load_station(write(text)).bench()


def test_missing_extra_is_named_before_anything_starts(
    write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "cv2" else found(name))

    with pytest.raises(ConfigError, match=r"cameras\.side.*pip install 'ctr-station\[camera\]'"):
        load_station(write("[cameras.side]\n")).bench()
    assert load_station(write("seed = 1\n")).bench().cameras == {}
