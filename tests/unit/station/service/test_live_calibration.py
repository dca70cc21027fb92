"""Where a station takes its tracker to stand before anything is calibrated."""

import numpy as np

from station.lab.aurora.coil import MOUNT
from station.service.live_calibration import believed_mount
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
