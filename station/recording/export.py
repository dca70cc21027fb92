"""Export of recordings to CSV, Parquet and MATLAB files, with the unit in the name of every column.

The first column, `motion_time [s]`, is the time since the start of the motion; the others are the recorded channels.
Without a motion it equals `time [s]`.
CSV and Parquet files are written block by block, so a recording may be longer than the memory. A MATLAB file has one
array for each channel and is created in memory.
"""

import functools
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.control.telemetry import Channel
from station.recording.data_section import unique_name
from station.recording.read import CaseReader, missing_rows, open_case
from station.recording.run_folder import SUMMARY_FILE, recordings, replacing
from station.recording.run_outcome import RecordingError
from station.regular_file import read_in

FORMATS = ("csv", "parquet", "mat")
MOTION_TIME = Channel("motion_time", "s")
#: Rate of the recorded rows [1/s].
TICK_RATE_HZ = 1.0 / PERIOD_S
#: Number of rows in a row group of a Parquet file: large enough to compress well, small enough for the memory.
ROW_GROUP_ROWS = 50_000
#: Longest variable name that MATLAB allows [characters].
MAX_MATLAB_NAME = 63
#: Largest variable that version 5 of the MATLAB file format allows [bytes].
MAX_MATLAB_BYTES = 2**31


class Choice(NamedTuple):
    """Selection of the content of an export."""

    fields: tuple[str, ...] = ()  #: names of fields as `tip_measured`, or of channels as `force.x`; empty: all
    rate: float = TICK_RATE_HZ  #: largest rate of the rows [1/s]

    @property
    def stride(self) -> int:
        """Number of recorded ticks per exported row."""
        return max(1, math.ceil(TICK_RATE_HZ / self.rate - 1e-9))

    def columns(self, channels: Sequence[Channel]) -> list[int]:
        """Return the indices of the chosen channels.

        Raises:
            RecordingError: a name is neither a field nor a channel of the recording.
        """
        known = [{channel.name, channel.name.partition(".")[0]} for channel in channels]
        unknown = [name for name in self.fields if not any(name in names for names in known)]
        if unknown:
            every = ", ".join(fields_of(channels))
            raise RecordingError(f"the recording has no {', '.join(map(repr, unknown))}; its fields are: {every}")
        return [at for at, names in enumerate(known) if not self.fields or not names.isdisjoint(self.fields)]


EVERYTHING = Choice()


def fields_of(channels: Iterable[Channel]) -> dict[str, int]:
    """Return the number of channels of each field of a recording, by the field's name."""
    return dict(Counter(channel.name.partition(".")[0] for channel in channels))


def export_run(
    folder: Path,
    kind: str,
    out: Path | None,
    progress: Callable[[str, float], None] = lambda _case, _part: None,
    case: str = "",
    choice: Choice = EVERYTHING,
    damaged: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write the cases of a run in another format.

    Args:
        folder: folder of the run.
        kind: one of FORMATS.
        out: a file for one case, a folder for several; None: the folder of the recordings.
        progress: receives the name of a case and the fraction of it that is done.
        case: name of the only case to write; empty: all cases.
        choice: fields and rate.
        damaged: receives a message for each case with damaged rows, which are missing.

    Returns:
        Paths of the written files, which are complete.

    Raises:
        RecordingError: the run has no such recording, one cannot be read, or the disk is full.
    """
    found = recordings(folder)
    if not found:
        raise RecordingError(f"{folder}: the folder has no recording")
    if case != "":
        names = ", ".join(path.stem for path in found)
        found = [path for path in found if path.stem == case]
        if not found:
            raise RecordingError(f"{folder}: the run has no case '{case}'; its cases are {names}")
    if out is not None and out.suffix == f".{kind}" and not out.is_dir():
        if len(found) > 1:
            names = ", ".join(path.stem for path in found)
            raise RecordingError(f"{out}: one file cannot have the cases {names}; give a folder or --case")
        targets = [out]
    else:
        targets = [(out or folder) / f"{path.stem}.{kind}" for path in found]
    for recording, target in zip(found, targets, strict=True):
        start = _motion_start(folder / SUMMARY_FILE, recording.stem)
        part = functools.partial(progress, recording.stem)
        if missing := export_case(recording, kind, target, start, part, choice):
            damaged(f"{recording}: {missing}")
    return targets


def export_case(
    recording: Path, kind: str, target: Path, start: float,
    progress: Callable[[float], None] = lambda _: None, choice: Choice = EVERYTHING,
) -> str:  # fmt: skip
    """Write a recording in another format to the file `target`, which gets its name only when it is complete.

    Return a message about damaged rows that are missing; empty if there are none.

    Args:
        recording: file of the recording.
        kind: one of FORMATS.
        target: file to write.
        start: time of the motion's start in the recording [s].
        progress: receives the fraction that is done.
        choice: fields and rate.

    Raises:
        RecordingError: the recording cannot be read or lacks a chosen field, or the disk is full.
    """
    write = {"csv": _csv, "parquet": _parquet, "mat": _mat}[kind]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with open_case(recording) as case, replacing(target) as unfinished:
            kept = choice.columns(case.channels)
            channels = (MOTION_TIME, *(case.channels[at] for at in kept))
            write(case, channels, _blocks(case, start, kept, choice.stride, progress), unfinished)
            return missing_rows(case.gaps())
    except OSError as error:
        raise RecordingError(f"{target}: cannot be written: {error.strerror or error}") from None


def matlab_names(channels: Sequence[Channel]) -> list[str]:
    """Return a valid and unique MATLAB variable name for each channel: `force.x [N]` becomes `force_x_N`."""
    taken: set[str] = set()
    names = (f"{channel.name}_{channel.unit.replace('/', '_per_')}" for channel in channels)
    plain = (re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") for name in names)
    return [unique_name(name, taken, MAX_MATLAB_NAME) for name in plain]


def _motion_start(summary: Path, case: str) -> float:
    """Return the time of the motion's start in a recording [s]; 0 in virtual time, where both start together."""
    try:
        cases = json.loads(read_in(summary.parent, summary.name)).get("cases", {})
        return float(cases.get(case, {}).get("motion_start", 0.0))
    except FileNotFoundError:
        return 0.0
    except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise RecordingError(f"{summary}: cannot read the start of the motion of '{case}': {error!r}") from None


def _blocks(
    case: CaseReader, start: float, kept: Sequence[int], stride: int, progress: Callable[[float], None]
) -> Iterable[Array]:
    """Yield every `stride`-th row: the time since the motion's start, then the `kept` channels."""
    done, time = 0, [channel.name for channel in case.channels].index("time")
    for rows in case.blocks():
        chosen = rows[-done % stride :: stride]
        if len(chosen):
            yield np.column_stack([chosen[:, time] - start, chosen[:, kept]])
        done += len(rows)
        progress(done / case.ticks)


def _csv(_case: CaseReader, channels: Sequence[Channel], blocks: Iterable[Array], target: Path) -> None:
    """Write a CSV file whose numbers have so many digits that a reader gets exactly the recorded values."""
    with target.open("wb") as file:
        file.write((",".join(_quoted(channel.column) for channel in channels) + "\n").encode())
        for rows in blocks:
            # Like `repr`, this JSON encoder writes the shortest exact digits; it is four times as fast.
            text = msgspec.json.encode(rows.tolist()).replace(b"null", b"nan")
            file.write(text[2:-2].replace(b"],[", b"\n") + b"\n")


def _quoted(name: str) -> str:
    return f'"{name}"' if "," in name else name


def _parquet(case: CaseReader, channels: Sequence[Channel], blocks: Iterable[Array], target: Path) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise RecordingError("Parquet needs the package pyarrow: pip install 'ctr-station[parquet]'") from None

    fields = [
        pyarrow.field(channel.column, pyarrow.float64(), metadata={"name": channel.name, "unit": channel.unit})
        for channel in channels
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


def _mat(case: CaseReader, channels: Sequence[Channel], blocks: Iterable[Array], target: Path) -> None:
    from scipy.io import savemat

    if 8 * case.ticks >= MAX_MATLAB_BYTES:
        raise RecordingError(f"{target}: {case.ticks} rows are more than a .mat file can store; export as parquet")
    columns = np.empty((len(channels), case.ticks))
    filled = 0
    for rows in blocks:
        columns[:, filled : filled + len(rows)] = rows.T
        filled += len(rows)
    columns = columns[:, :filled]
    names = matlab_names(channels)
    content: Mapping[str, Any] = {
        **{name: column[:, None] for name, column in zip(names, columns, strict=True)},
        "units": {name: channel.unit for name, channel in zip(names, channels, strict=True)},
        "channels": {name: channel.name for name, channel in zip(names, channels, strict=True)},
        "label": str(case.label),
    }
    savemat(target, dict(content), appendmat=False, do_compression=True, long_field_names=True)
