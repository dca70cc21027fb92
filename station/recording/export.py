"""Recordings for other programs: CSV, Parquet, MATLAB, with the unit in every column's name.

CSV and Parquet are written block by block, whatever the length. A MATLAB file is one array a channel
and is made in memory.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.control.telemetry import Channel
from station.recording.label import RecordingError
from station.recording.read import CaseReader, open_case
from station.recording.run_folder import RECORDING

FORMATS = ("csv", "parquet", "mat")
#: Rows of a Parquet row group: large enough to compress, small enough to hold.
GROUP = 50_000
#: Longest name that MATLAB takes.
MATLAB_NAME = 63
#: Version 5 of the MATLAB format holds no more in one variable [bytes].
MATLAB_LIMIT = 2**31


def export_run(
    folder: Path, kind: str, out: Path | None, progress: Callable[[str, float], None] = lambda _case, _part: None
) -> list[Path]:
    """Write every case of a run in another format.

    Args:
        folder: of the run.
        kind: one of FORMATS.
        out: a file for a run with one case, a folder for more; None for beside the recording.
        progress: told the case and the part of it that is done.

    Returns:
        The files, each whole.

    Raises:
        RecordingError: no recording, one that cannot be read, or a disk that takes no more.
    """
    recordings = sorted(folder.glob(f"*{RECORDING}"))
    if not recordings:
        raise RecordingError(f"{folder}: no recording there")
    if out is not None and out.suffix == f".{kind}" and not out.is_dir():
        if len(recordings) > 1:
            names = ", ".join(path.stem for path in recordings)
            raise RecordingError(f"{out}: one file for the cases {names}; give a folder")
        places = [out]
    else:
        places = [(out or folder) / f"{path.stem}.{kind}" for path in recordings]
    for recording, place in zip(recordings, places, strict=True):
        export_case(recording, kind, place, lambda part, name=recording.stem: progress(name, part))
    return places


def export_case(recording: Path, kind: str, place: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write a recording as `place`, which gets its name only when it is whole.

    Raises:
        RecordingError: the recording cannot be read, or the disk takes no more.
    """
    write = {"csv": _csv, "parquet": _parquet, "mat": _mat}[kind]
    unfinished = place.with_name(place.name + ".partial")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with open_case(recording) as case:
            try:
                write(case, _watched(case, progress), unfinished)
                unfinished.replace(place)
            finally:
                unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"{place}: cannot be written: {error.strerror or error}") from None


def matlab_names(channels: Sequence[Channel]) -> list[str]:
    """Legal names, all different: `force.x [N]` becomes `force_x_N`."""
    taken: set[str] = set()
    names: list[str] = []
    for channel in channels:
        plain = re.sub(r"\W+", "_", f"{channel.name}_{channel.unit.replace('/', '_per_')}", flags=re.ASCII).strip("_")
        plain = base = (plain if plain[:1].isalpha() else f"c_{plain}")[:MATLAB_NAME]
        number = 2
        while plain in taken:
            ending = f"_{number}"
            plain, number = base[: MATLAB_NAME - len(ending)] + ending, number + 1
        taken.add(plain)
        names.append(plain)
    return names


def _watched(case: CaseReader, progress: Callable[[float], None]) -> Iterable[Array]:
    done = 0
    for rows in case.blocks():
        yield rows
        done += len(rows)
        progress(done / case.ticks)


def _csv(case: CaseReader, blocks: Iterable[Array], place: Path) -> None:
    """Numbers that read back to the same bits."""
    with place.open("w", encoding="utf-8") as file:
        file.write(",".join(_quoted(channel.column) for channel in case.channels) + "\n")
        for rows in blocks:
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows.tolist())


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def _parquet(case: CaseReader, blocks: Iterable[Array], place: Path) -> None:
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

    with parquet.ParquetWriter(place, schema, compression="zstd") as writer:
        gathered: list[Array] = []
        for rows in blocks:
            gathered.append(rows)
            if sum(map(len, gathered)) >= GROUP:
                writer.write_table(table(gathered))
                gathered = []
        writer.write_table(table(gathered))


def _mat(case: CaseReader, blocks: Iterable[Array], place: Path) -> None:
    from scipy.io import savemat

    if 8 * case.ticks >= MATLAB_LIMIT:
        raise RecordingError(f"{place}: {case.ticks} rows are more than a .mat file holds; export as parquet")
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
    savemat(place, dict(content), appendmat=False, do_compression=True, long_field_names=True)
