"""Where a station takes its tracker to stand before anything is calibrated."""

import numpy as np

from station.lab.aurora.coil import MOUNT
from station.service.live_calibration import believed_mount
from station.service.station_file import load_station


def test_what_a_bench_says_about_its_tracker_is_what_is_assumed(tmp_path):
    assert believed_mount(load_station(None).bench()) is MOUNT
    path = tmp_path / "bench.toml"
    path.write_text(
        """
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"
mount = { position = [0.1, 0.0, -0.3], rotation_vector = [0.0, 0.0, 1.5707963267948966] }
[devices.sensors]
driver = "netft"
tubes.inner.host = "192.168.1.11"
tubes.outer.host = "192.168.1.12"
""",
        encoding="utf-8",
    )

    found = believed_mount(load_station(path).bench())

    np.testing.assert_allclose(found.position, [0.1, 0.0, -0.3])
    np.testing.assert_allclose(found.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
