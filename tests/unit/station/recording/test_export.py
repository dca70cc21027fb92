"""Exported recordings, read by other programs."""

import csv
import sys

import numpy as np
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from station.control.telemetry import Channel
from station.recording.export import ROW_GROUP_ROWS, Choice, export_case, export_run, matlab_names
from station.recording.read import missing_rows, read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import CaseWriter
from tests.harness.recordings import as_recorded


@pytest.fixture
def rows(make_rows, channels):
    rows = make_rows(230)
    rows[3, 5:8] = (1e-30, -0.0, 1.0 / 3.0)
    return as_recorded(rows, channels.all)


@pytest.fixture
def run(recorded, rows, tmp_path):
    """Return a folder with one recording."""
    recorded(rows, "one")
    return tmp_path


def same(found, rows) -> bool:
    """Return whether the channels, which follow the time of the motion, are the recorded ones."""
    return bool((np.asarray(found, float)[:, 1:] == rows).all())


def test_an_exported_csv_file_reads_back_to_the_same_numbers_with_units_in_the_header(run, rows, channels):
    (path,) = export_run(run, "csv", None)
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)

    assert path == run / "one.csv"
    assert header == ["motion_time [s]", *(channel.column for channel in channels.all)]
    assert {"time [s]", "joints.inner_translation [m]", "wrench_raw.outer_mz [N m]", "tip_true.x [m]"} <= set(header)
    assert same(lines, rows)


def test_an_export_has_the_chosen_fields_and_every_fifth_row_at_a_hundred_a_second(run, rows, channels):
    (path,) = export_run(run, "csv", None, choice=Choice(("tip_measured", "force.x"), 100.0))
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)

    assert header == ["motion_time [s]", "force.x [N]", *(f"tip_measured.{axis} [m]" for axis in "xyz")]
    names = [channel.name for channel in channels.all]
    kept = [names.index("force.x"), *(names.index(f"tip_measured.{axis}") for axis in "xyz")]
    assert same(lines, rows[::5][:, kept])


@pytest.mark.parametrize("rate", [500.0, 100.0, 40.0, 0.1])
def test_blocks_with_fewer_rows_than_the_stride_leave_no_empty_line(tmp_path, paper, channels, rate):
    writer, counts = CaseWriter(tmp_path / "short.mcap", paper.robot(), channels.all, {}, pictures=1e-6), (1, 2, 7, 300)
    times = np.arange(float(sum(counts)))
    for block in np.split(times, np.cumsum(counts)[:-1]):
        writer.write(np.column_stack([block, np.zeros((len(block), len(channels) - 1))]))
    writer.close(RunOutcome.COMPLETE)
    export_case(writer.path, "csv", tmp_path / "short.csv", 0.0, choice=Choice(rate=rate))
    lines = (tmp_path / "short.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [float(line.split(",")[0]) for line in lines] == times[:: Choice(rate=rate).stride].tolist()


@pytest.mark.parametrize(("rate", "stride"), [(500.0, 1), (499.0, 2), (250.0, 2), (100.0, 5), (40.0, 13), (0.1, 5000)])
def test_an_export_never_has_more_rows_a_second_than_asked_for(rate, stride):
    assert Choice(rate=rate).stride == stride


def test_a_field_that_was_not_recorded_is_refused_with_the_fields_there_are(run):
    with pytest.raises(RecordingError, match=r"has no 'tip_meazured'; its fields are: time, .*tip_measured"):
        export_run(run, "csv", None, choice=Choice(("force", "tip_meazured")))
    assert not list(run.glob("*.csv*"))


def test_an_exported_parquet_file_has_the_columns_the_units_and_the_label(run, rows, channels):
    (path,) = export_run(run, "parquet", None)
    table = parquet.read_table(path)

    assert table.column_names == ["motion_time [s]", *(channel.column for channel in channels.all)]
    assert same(np.stack([column.to_numpy() for column in table.columns], axis=1), rows)
    field = table.schema.field("force.x [N]")
    assert field.metadata == {b"name": b"force.x", b"unit": b"N"}
    assert table.schema.metadata[b"label"] == b"complete"


def test_a_long_parquet_file_has_row_groups_and_an_empty_one_has_columns(tmp_path, paper, channels):
    for name, count in (("long", ROW_GROUP_ROWS + 2500), ("none", 0)):
        writer = CaseWriter(tmp_path / f"{name}.mcap", paper.robot(), channels.all, {}, pictures=1e-6)
        block = np.zeros((2500, len(channels)))
        for first in range(0, count, 2500):
            block[:, 0] = first + np.arange(2500)
            writer.write(block)
        writer.close(RunOutcome.COMPLETE)
        export_case(writer.path, "parquet", tmp_path / f"{name}.parquet", 0.0)
        with parquet.ParquetFile(tmp_path / f"{name}.parquet") as found:
            assert found.metadata.num_rows == count
            assert found.schema_arrow.names == ["motion_time [s]", *(channel.column for channel in channels.all)]
            if count:
                assert found.num_row_groups == 2
                assert (found.read(columns=["time [s]"]).column(0).to_numpy() == np.arange(count)).all()


def test_a_matlab_file_has_valid_names_and_the_original_ones(run, rows, channels):
    (path,) = export_run(run, "mat", None)
    content = loadmat(path, squeeze_me=True)

    assert (content["force_x_N"] == channels.of(rows, "force")[:, 0]).all()
    assert (content["velocity_sent_inner_translation_m_per_s"] == channels.of(rows, "velocity_sent")[:, 2]).all()
    assert content["units"]["force_x_N"] == "N"
    assert content["channels"]["wrench_raw_outer_mz_N_m"] == "wrench_raw.outer_mz"
    assert content["label"] == "complete"
    assert sum(not name.startswith("__") for name in content) == 1 + len(channels) + 3


def test_matlab_names_are_valid_and_unique():
    odd = [Channel(name, unit) for name, unit in (("a-b", "m"), ("a_b", "m"), ("2nd", ""), ("x" * 80, "m"))]
    odd += [Channel("x" * 80, "N"), Channel("ü", "1/s")]
    names = matlab_names(odd)

    assert names[:3] == ["a_b_m", "a_b_m_2", "c_2nd"]
    assert len(set(names)) == len(names)
    assert all(name.isidentifier() and name.isascii() and len(name) <= 63 and name[0].isalpha() for name in names)


def test_an_export_of_one_case_is_a_file_and_of_several_a_folder(run, recorded, make_rows, tmp_path):
    assert export_run(run, "csv", tmp_path / "deep" / "x.csv") == [tmp_path / "deep" / "x.csv"]
    recorded(make_rows(5), "two")
    with pytest.raises(RecordingError, match="one file cannot have the cases one, two; give a folder or --case"):
        export_run(run, "csv", tmp_path / "x.csv")
    assert export_run(run, "csv", tmp_path / "out") == [tmp_path / "out" / "one.csv", tmp_path / "out" / "two.csv"]
    assert export_run(run, "csv", tmp_path / "x.csv", case="two") == [tmp_path / "x.csv"]
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 1 + 5
    with pytest.raises(RecordingError, match="the run has no case 'three'; its cases are one, two"):
        export_run(run, "csv", None, case="three")


def test_the_motion_time_counts_from_the_start_that_the_summary_states(run, rows):
    (run / "summary.json").write_text('{"cases": {"one": {"motion_start": 0.25}}}')
    (path,) = export_run(run, "csv", None)

    found = np.loadtxt(path, delimiter=",", skiprows=1)
    assert found[:, 0].tolist() == [time - 0.25 for time in rows[:, 0].tolist()]
    (run / "summary.json").write_text("[]")
    with pytest.raises(RecordingError, match="cannot read the start of the motion of 'one'"):
        export_run(run, "csv", None)


def test_parquet_without_pyarrow_is_refused_with_the_install_command(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)  # simulates that pyarrow is not installed
    with pytest.raises(RecordingError, match=r"Parquet needs .* pip install 'ctr-station\[parquet\]'"):
        export_run(run, "parquet", None)
    assert [path.name for path in run.iterdir()] == ["one.mcap"]


def test_an_export_without_a_recording_or_a_writable_target_is_refused(tmp_path, run):
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="empty: the folder has no recording"):
        export_run(tmp_path / "empty", "csv", None)
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(RecordingError, match="cannot be written"):
        export_run(run, "csv", tmp_path / "file")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_the_export_of_a_damaged_recording_names_the_missing_rows(run, kind):
    content = bytearray((run / "one.mcap").read_bytes())
    content[len(content) // 2] ^= 1
    (run / "one.mcap").write_bytes(content)
    damaged: list[str] = []
    (file,) = export_run(run, kind, None, damaged=damaged.append)
    assert damaged == [f"{run / 'one.mcap'}: {missing_rows(read_case(run / 'one.mcap').gaps)}"]
    assert "100 rows are damaged and missing" in damaged[0]
    assert {path.name for path in run.iterdir()} == {file.name, "one.mcap"}
