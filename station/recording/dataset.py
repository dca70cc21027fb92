"""Datasets of poses from recordings or validations: one Parquet file, and a datasheet in Markdown.

Each row is a tracker frame of a run, at most one every `interval` seconds, or a pose of a validation. The columns that
`ctr-station validate` reads have the names of its table of poses; the others have the names of channels, which contain
dots. Every case of a run is a trajectory; a run with one case is divided into five. Each fifth trajectory is for tests.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.config.strict import text_of
from station.recording.read import CaseReader, open_case
from station.recording.run_folder import recordings
from station.recording.run_outcome import RecordingError
from station.regular_file import read_in

#: File with the poses of a validation, and names of the two files of a dataset.
ERRORS_FILE, DATA_FILE, SHEET_FILE = "errors.csv", "dataset.parquet", "dataset.md"
#: Shortest time between two rows by default [s]: neighbouring frames are almost the same pose.
INTERVAL_S = 0.25
#: Number of trajectories into which a single case or a validation is divided; one in `TEST_EVERY` is for tests.
PARTS, TEST_EVERY = 5, 5
#: Channel groups of a dataset, with the prefix of their columns; "": no prefix; None: the names of the channels.
GROUPS = (
    ("joints", ""), ("tip_measured", "tip"), ("force_filtered", "force"), ("wrench_raw", None), ("tip_true", None),
    ("force_true", None), ("direction_measured", None), ("residual", None),
)  # fmt: skip
MEANINGS = """\
| columns | content | frame |
|---|---|---|
| `trajectory`, `split`, `time` | trajectory's number; `train` or `test`; time, increasing over all trajectories | |
| joints by name | positions that the stages report | |
| `tip_x`, `tip_y`, `tip_z` | tip in the tracker's frame of data | robot |
| `force_x`, `force_y`, `force_z` | filtered force at the tip | robot |
| `wrench_raw.*` | base sensors, not tared | sensor |
| `tip_true.*`, `force_true.*` | true values; zero without a virtual lab | robot |
| `direction_measured.*` | axis of the tip that the tracker measures; zero if not measured | robot |
| `residual.*` | learned correction that the model's tip contains in this row | robot |
| `error.*` | measured minus modelled tip of a validation | robot |
"""


class Column(NamedTuple):
    """Name and unit of a column."""

    name: str
    unit: str


def export_dataset(folder: Path, out: Path | None, licence: str, interval: float = INTERVAL_S) -> list[Path]:
    """Write the dataset of a run or of a validation; return the paths of both files.

    Args:
        folder: folder of a run, or of a validation.
        out: folder for the files; None: `folder`.
        licence: licence of the data, for the datasheet.
        interval: shortest time between two rows of a run [s].

    Raises:
        RecordingError: there is nothing to export, it cannot be read, or the files cannot be written.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise RecordingError("a dataset needs the package pyarrow: pip install 'ctr-station[parquet]'") from None
    about: dict[str, Any] = {"source": folder.name}
    if (folder / ERRORS_FILE).is_file():
        columns, rows = _validation(folder)
    else:
        columns, rows = _run(folder, interval, about)
    if not len(rows):
        raise RecordingError(f"{folder}: no tracker frame in the recordings, so a dataset would be empty")
    number = _trajectories(rows[:, 0])
    split = ["test" if k % TEST_EVERY == TEST_EVERY - 1 else "train" for k in number.tolist()]
    about |= {"version": version("ctr-station"), "licence": licence, "rows": len(rows)}
    for_tests = len({n for n, part in zip(number.tolist(), split, strict=True) if part == "test"})
    about["trajectories"] = f"{number.max() + 1}, of which {for_tests} for tests"
    fields = [pyarrow.field("trajectory", pyarrow.int64()), pyarrow.field("split", pyarrow.string())]
    fields += [pyarrow.field(c.name, pyarrow.float64(), metadata={"unit": c.unit}) for c in columns]
    schema = pyarrow.schema(fields, metadata={key: str(value) for key, value in about.items()})
    arrays = [pyarrow.array(number), pyarrow.array(split), *(pyarrow.array(column) for column in rows[:, 1:].T)]
    target = folder if out is None else out
    try:
        target.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), target / DATA_FILE, compression="zstd")
        (target / SHEET_FILE).write_text(_datasheet(about, columns), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{target}: cannot be written: {error.strerror or error}") from None
    return [target / DATA_FILE, target / SHEET_FILE]


def _trajectories(cases: Array) -> NDArray[np.int64]:
    """Return the number of each row's trajectory; a single case is divided into parts of consecutive rows."""
    number = np.unique(cases, return_inverse=True)[1]
    return number if number.any() else np.arange(len(cases)) * PARTS // len(cases)


def _run(folder: Path, interval: float, about: dict[str, Any]) -> tuple[list[Column], Array]:
    """Return the columns, and the rows (m, 1 + columns) of all cases; the first number of a row is the case's index."""
    found, columns, start = list[Array](), list[Column](), 0.0
    for number, path in enumerate(recordings(folder)):
        with open_case(path) as case:
            columns, rows = _case(case, interval)
            known = {"robot": "robot", "experiment": "experiment", "seed": "seed", "lab": "lab", "start": "started"}
            about |= {name: _named(case.metadata[key]) for key, name in known.items() if key in case.metadata}
        if len(rows):
            rows[:, 0] += start - rows[0, 0]
            start = float(rows[-1, 0]) + 1.0
            found.append(np.column_stack((np.full(len(rows), float(number)), rows)))
    if not columns:
        raise RecordingError(f"{folder}: the folder has no recording, and no {ERRORS_FILE} of a validation")
    return columns, np.concatenate(found) if found else np.empty((0, 1 + len(columns)))


def _named(value: Any) -> Any:
    return value.get("name", value.get("title", "")) if isinstance(value, Mapping) else value


def _case(case: CaseReader, interval: float) -> tuple[list[Column], Array]:
    """Return the columns and rows of one case: one row for each tracker frame, but at most one per `interval` [s]."""
    names = [channel.name for channel in case.channels]
    places, columns = [names.index("time")], [Column("time", "s")]
    for group, prefix in GROUPS:
        for k, channel in enumerate(case.channels):
            if channel.name.startswith(f"{group}."):
                part = channel.name.removeprefix(f"{group}.")
                name = channel.name if prefix is None else f"{prefix}_{part}" if prefix else part
                places.append(k)
                columns.append(Column(name, channel.unit))
    fresh, frozen, rows, last = names.index("tip_new"), names.index("estimates_frozen"), list[Array](), -np.inf
    for block in case.blocks():
        for row in block[(block[:, fresh] > 0.0) & (block[:, frozen] == 0.0)]:
            if row[places[0]] >= last + interval and np.isfinite(row[places]).all():
                last = row[places[0]]
                rows.append(row[places])
    return columns, np.array(rows).reshape(-1, len(places))


def _validation(folder: Path) -> tuple[list[Column], Array]:
    """Return the columns and rows of a validation's table of errors; the line numbers are replaced by 0."""
    try:
        header, *lines = csv.reader(text_of(read_in(folder, ERRORS_FILE)).splitlines())
        rows = np.array([[float(cell) for cell in cells] for cells in lines])
    except (OSError, ValueError) as error:
        raise RecordingError(f"{folder / ERRORS_FILE}: cannot be read: {error}") from None
    unit = {"force": "N", "tip": "m", "error": "m"}
    columns = [
        Column(
            name.replace("error", "error."),
            unit.get(name.split("_")[0], "m" if name.endswith("translation") else "rad"),
        )
        for name in header[1:]
    ]
    rows[:, 0] = 0.0
    return columns, rows


def _datasheet(about: Mapping[str, Any], columns: Sequence[Column]) -> str:
    """Return the datasheet, which describes origin, units, frames and use of the data."""

    def lines() -> Iterator[str]:
        yield "# Dataset of poses\n"
        yield from (f"* {name}: {value}" for name, value in about.items())
        yield "\nThe robot's frame has its origin at the front plate and z along the tubes. The backbone is not"
        yield "recorded. Poses of one trajectory are neighbours, so the split keeps each trajectory in one part.\n"
        yield MEANINGS
        yield f"Units: {', '.join(f'`{c.name}` [{c.unit}]' for c in columns if c.unit)}.\n"
        yield "    ctr-station validate ROBOT dataset.parquet --fit residual"
        yield '    pandas.read_parquet("dataset.parquet")\n'

    return "\n".join(lines())
