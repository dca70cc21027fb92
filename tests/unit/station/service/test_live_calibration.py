"""Preparation of a calibration procedure: the assumed pose of the tracker, and a separate folder for its results."""

from types import SimpleNamespace

import numpy as np
import pytest

from station.calibration.files import new_folder
from station.config.strict import ConfigError
from station.lab.aurora_coil import GENERATOR_POSE
from station.service.live_calibration import LiveCalibration, assumed_mount
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES

MOUNTED = """
mount = { position = [0.1, 0.0, -0.3], rotation_vector = [0.0, 0.0, 1.5707963267948966] }
"""


def test_calibration_assumes_the_tracker_pose_of_the_station_file(write):
    assert assumed_mount(load_station(None).bench()) is GENERATOR_POSE
    port = 'port = "/dev/ttyUSB1"\n'
    path = write(OWN_DEVICES.replace(port, port + MOUNTED))

    found = assumed_mount(load_station(path).bench())

    np.testing.assert_allclose(found.position, [0.1, 0.0, -0.3])
    np.testing.assert_allclose(found.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_calibrations_of_the_same_second_have_separate_folders(tmp_path):
    folders = [new_folder(tmp_path / "calibrations", "tubes-20260101-000000") for _ in range(3)]

    assert [folder.name for folder in folders] == [f"tubes-20260101-000000{more}" for more in ("", "-2", "-3")]


def test_calibration_without_a_writable_folder_is_refused_before_anything_moves(tmp_path):
    (tmp_path / "calibrations").write_text("a file")
    reserved = []
    bench = load_station(None).bench()
    station = SimpleNamespace(
        bench=bench,
        simulated=True,
        permit=lambda: None,
        reserve=lambda why, _permit: reserved.append(why),
        release=reserved.clear,
    )

    with pytest.raises(ConfigError, match=f"{tmp_path}/calibrations: cannot write results there: File exists"):
        LiveCalibration(station, tmp_path / "calibrations").start("axes")
    assert not reserved
