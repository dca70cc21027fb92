"""Datasets from recordings, read by pandas."""

import numpy as np
import pandas
import pytest
from pyarrow import parquet

from station.recording.dataset import export_dataset
from station.recording.run_outcome import RecordingError
from tests.harness.recordings import as_recorded


@pytest.fixture
def rows(make_rows, channels):
    rows = make_rows(2000)
    channels.of(rows, "time")[:] = 2e-3 * np.arange(2000)[:, None]
    channels.of(rows, "tip_new")[:] = (np.arange(2000) % 12 == 0)[:, None]
    channels.of(rows, "estimates_frozen")[:] = 0.0
    return as_recorded(rows, channels.all)


def test_a_dataset_has_tracker_frames_with_the_numbers_of_the_recording(recorded, rows, channels, tmp_path):
    for case in ("one", "two"):
        recorded(rows, case)
    data, sheet = export_dataset(tmp_path, tmp_path / "out", "CC0", interval=0.1)
    frame, times = pandas.read_parquet(data), channels.of(rows, "time")[:, 0]
    first = frame[frame["trajectory"] == 0]
    at = [int(np.flatnonzero(times == time)[0]) for time in first["time"] - first["time"].iloc[0] + times[0]][:1]

    assert set(frame["trajectory"]) == {0, 1}
    assert frame["time"].is_monotonic_increasing
    assert np.diff(first["time"]).min() >= 0.1 - 1e-9
    assert first["tip_x"].iloc[0] == channels.of(rows, "tip_measured")[at[0], 0]
    assert first["inner_translation"].iloc[0] in channels.of(rows, "joints")[at[0]]
    assert parquet.read_schema(data).field("force_x").metadata[b"unit"] == b"N"
    assert "licence: CC0" in sheet.read_text(encoding="utf-8")


def test_a_folder_without_recordings_or_errors_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"no recording, and no errors.csv"):
        export_dataset(tmp_path, None, "CC0")
