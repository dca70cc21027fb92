"""Before a procedure begins: where a station takes its tracker to stand, and a folder of its own for the results."""

from types import SimpleNamespace

import numpy as np
import pytest

from station.calibration.folder import new_folder
from station.config.strict import ConfigError
from station.lab.aurora.coil import MOUNT
from station.service.live_calibration import LiveCalibration, believed_mount
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES

MOUNTED = """
mount = { position = [0.1, 0.0, -0.3], rotation_vector = [0.0, 0.0, 1.5707963267948966] }
"""


def test_what_a_bench_says_about_its_tracker_is_what_is_assumed(write):
    assert believed_mount(load_station(None).bench()) is MOUNT
    port = 'port = "/dev/ttyUSB1"\n'
    path = write(OWN_DEVICES.replace(port, port + MOUNTED))

    found = believed_mount(load_station(path).bench())

    np.testing.assert_allclose(found.position, [0.1, 0.0, -0.3])
    np.testing.assert_allclose(found.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_calibrations_of_the_same_second_have_folders_of_their_own(tmp_path):
    places = [new_folder(tmp_path / "calibrations", "tubes-20260101-000000") for _ in range(3)]

    assert [place.name for place in places] == [f"tubes-20260101-000000{more}" for more in ("", "-2", "-3")]


def test_a_procedure_that_has_nowhere_to_go_is_refused_before_anything_moves(tmp_path):
    (tmp_path / "calibrations").write_text("a file")
    reserved = []
    station = SimpleNamespace(bench=load_station(None).bench(), reserve=reserved.append, release=reserved.clear)

    with pytest.raises(ConfigError, match=f"{tmp_path}/calibrations: cannot write results there: File exists"):
        LiveCalibration(station, tmp_path / "calibrations").start("axes")
    assert not reserved
