"""A station with a slow clock has the rows of a station in real time, and more real time for each row."""

import time
from pathlib import Path

import numpy as np
import pytest

from station.client import Station
from station.config.controllers import PERIOD_S
from station.recording.read import read_case
from tests.harness.calm import RATE
from tests.harness.serving import Served

DURATION = 1.0  # duration of the run by the station's clock [s]


def test_run_with_a_slow_clock_has_the_rows_of_real_time_and_lasts_longer(running: Served, tmp_path: Path) -> None:
    running.ready()
    with Station(running.url) as station:
        begin = time.monotonic()
        run = station.start(trajectory={"kind": "hold"}, duration=DURATION)
        status = station.wait(run)
        lasted = time.monotonic() - begin
        recording = read_case(station.download(run, tmp_path / "run.mcap"))

    times = recording.of("time")[:, 0]
    steps = np.diff(times) / PERIOD_S
    assert np.median(steps) == pytest.approx(1.0)
    assert steps == pytest.approx(np.round(steps))
    assert times[-1] - times[0] > DURATION
    assert lasted > (times[-1] - times[0]) / RATE
    assert recording.metadata["clock_rate"] == RATE
    assert f"not in real time: this station's clock runs at {RATE:g} times real time (clock.rate)" in status["warnings"]
