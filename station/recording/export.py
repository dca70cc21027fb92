"""Export of recordings to CSV, Parquet and MATLAB files, with the unit in the name of every column.

CSV and Parquet files are written block by block, so a recording may be longer than the memory. A MATLAB file has one
array for each channel and is created in memory.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.control.telemetry import Channel
from station.recording.data_section import unique_name
from station.recording.read import CaseReader, open_case
from station.recording.run_folder import RECORDING_SUFFIX
from station.recording.run_outcome import RecordingError

FORMATS = ("csv", "parquet", "mat")
#: Number of rows in a row group of a Parquet file: large enough to compress well, small enough for the memory.
ROW_GROUP_ROWS = 50_000
#: Longest variable name that MATLAB allows [characters].
MAX_MATLAB_NAME = 63
#: Largest variable that version 5 of the MATLAB file format allows [bytes].
MAX_MATLAB_BYTES = 2**31


def export_run(
    folder: Path, kind: str, out: Path | None, progress: Callable[[str, float], None] = lambda _case, _part: None
) -> list[Path]:
    """Write every case of a run in another format.

    Args:
        folder: folder of the run.
        kind: one of FORMATS.
        out: a file for a run with one case, a folder for a run with several; None: the folder of the recordings.
        progress: receives the name of a case and the fraction of it that is done.

    Returns:
        Paths of the written files, which are complete.

    Raises:
        RecordingError: the run has no recording, one cannot be read, or the disk is full.
    """
    recordings = sorted(folder.glob(f"*{RECORDING_SUFFIX}"))
    if not recordings:
        raise RecordingError(f"{folder}: the folder has no recording")
    if out is not None and out.suffix == f".{kind}" and not out.is_dir():
        if len(recordings) > 1:
            names = ", ".join(path.stem for path in recordings)
            raise RecordingError(f"{out}: one file for the cases {names}; give a folder")
        targets = [out]
    else:
        targets = [(out or folder) / f"{path.stem}.{kind}" for path in recordings]
    for recording, target in zip(recordings, targets, strict=True):
        export_case(recording, kind, target, lambda part, name=recording.stem: progress(name, part))
    return targets


def export_case(recording: Path, kind: str, target: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write a recording in another format to the file `target`, which gets its name only when it is complete.

    Raises:
        RecordingError: the recording cannot be read, or the disk is full.
    """
    write = {"csv": _csv, "parquet": _parquet, "mat": _mat}[kind]
    unfinished = target.with_name(target.name + ".partial")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with open_case(recording) as case:
            try:
                write(case, _watched(case, progress), unfinished)
                unfinished.replace(target)
            finally:
                unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"{target}: cannot be written: {error.strerror or error}") from None


def matlab_names(channels: Sequence[Channel]) -> list[str]:
    """Return a valid and unique MATLAB variable name for each channel: `force.x [N]` becomes `force_x_N`."""
    taken: set[str] = set()
    names = (f"{channel.name}_{channel.unit.replace('/', '_per_')}" for channel in channels)
    plain = (re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") for name in names)
    return [unique_name(name, taken, MAX_MATLAB_NAME) for name in plain]


def _watched(case: CaseReader, progress: Callable[[float], None]) -> Iterable[Array]:
    done = 0
    for rows in case.blocks():
        yield rows
        done += len(rows)
        progress(done / case.ticks)


def _csv(case: CaseReader, blocks: Iterable[Array], target: Path) -> None:
    """Write a CSV file whose numbers have enough digits to be read back to the same bits."""
    with target.open("w", encoding="utf-8") as file:
        file.write(",".join(_quoted(channel.column) for channel in case.channels) + "\n")
        for rows in blocks:
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows.tolist())


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def _parquet(case: CaseReader, blocks: Iterable[Array], target: Path) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise RecordingError("Parquet needs the package pyarrow: pip install 'ctr-station[parquet]'") from None

    fields = [
        pyarrow.field(channel.column, pyarrow.float64(), metadata={"name": channel.name, "unit": channel.unit})
        for channel in case.channels
    ]
    about = {"label": case.label, "cause": case.cause}
    schema = pyarrow.schema(fields, metadata=about)

    def table(rows: Sequence[Array]) -> Any:
        columns = np.ascontiguousarray(np.concatenate(rows).T) if rows else np.empty((len(fields), 0))
        return pyarrow.Table.from_arrays([pyarrow.array(column) for column in columns], schema=schema)

    with parquet.ParquetWriter(target, schema, compression="zstd") as writer:
        gathered: list[Array] = []
        for rows in blocks:
            gathered.append(rows)
            if sum(map(len, gathered)) >= ROW_GROUP_ROWS:
                writer.write_table(table(gathered))
                gathered = []
        writer.write_table(table(gathered))


def _mat(case: CaseReader, blocks: Iterable[Array], target: Path) -> None:
    from scipy.io import savemat

    if 8 * case.ticks >= MAX_MATLAB_BYTES:
        raise RecordingError(f"{target}: {case.ticks} rows are more than a .mat file can store; export as parquet")
    columns = np.empty((len(case.channels), case.ticks))
    filled = 0
    for rows in blocks:
        columns[:, filled : filled + len(rows)] = rows.T
        filled += len(rows)
    names = matlab_names(case.channels)
    content: Mapping[str, Any] = {
        **{name: column[:, None] for name, column in zip(names, columns, strict=True)},
        "units": {name: channel.unit for name, channel in zip(names, case.channels, strict=True)},
        "channels": {name: channel.name for name, channel in zip(names, case.channels, strict=True)},
        "label": str(case.label),
    }
    savemat(target, dict(content), appendmat=False, do_compression=True, long_field_names=True)
