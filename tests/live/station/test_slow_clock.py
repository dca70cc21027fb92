"""A station whose clock is slow: the rows of one in real time, and more real time for each."""

import time
from pathlib import Path

import numpy as np
import pytest

from station.client import Station
from station.config.controllers import PERIOD
from station.recording.read import read_case
from tests.harness.calm import RATE
from tests.harness.serving import Served

DURATION = 1.0  # [s] of the station


def test_rows_are_as_in_real_time_and_the_run_lasts_longer(running: Served, tmp_path: Path) -> None:
    running.ready()
    with Station(running.url) as station:
        begin = time.monotonic()
        run = station.start(trajectory={"kind": "hold"}, duration=DURATION)
        status = station.wait(run)
        lasted = time.monotonic() - begin
        recording = read_case(station.download(run, tmp_path / "run.mcap"))

    times = recording.of("time")[:, 0]
    steps = np.diff(times) / PERIOD
    assert np.median(steps) == pytest.approx(1.0)
    assert steps == pytest.approx(np.round(steps))
    assert times[-1] - times[0] > DURATION
    assert lasted > (times[-1] - times[0]) / RATE
    assert recording.metadata["clock_rate"] == RATE
    assert f"not in real time: this station's clock goes at {RATE:g} of it (clock.rate)" in status["warnings"]
