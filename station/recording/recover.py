"""Recovery of recordings whose writer was killed.

A recovery cuts the file after its last complete chunk, adds the index and a label, and renames it. It takes place when
a command starts the next time. A recovery that is killed can be repeated, because it never changes a chunk.
"""

import contextlib
import json
import os
import shutil
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.records import Chunk, Metadata
from mcap.stream_reader import StreamReader

from station.recording.metadata import RUN_RECORD, is_later, texts, values_of
from station.recording.read import open_case
from station.recording.run_folder import (
    EXPERIMENT_FILE,
    RECORDING_SUFFIX,
    SUMMARY_FILE,
    VIDEOS_FOLDER,
    lock_folder,
    recordings,
    write_json,
)
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.summary import finish_file
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX
from station.regular_file import is_regular, open_in

CAUSES = {
    RunOutcome.INTERRUPTED: "the recording process ended; recovered up to the last chunk that reached the disk",
    RunOutcome.INCOMPLETE: "the disk was full",
}
#: Files and folders that the folder of an unfinished run without a recording may have.
RUN_FILES = {EXPERIMENT_FILE, SUMMARY_FILE, VIDEOS_FOLDER}


def recover(runs: Path) -> list[Path]:
    """Finish every run that no process writes any more, except runs of a later ctr-station (see `unrecoverable`).

    Args:
        runs: folder of the runs; it need not exist.

    Returns:
        The recovered folders with their final names.

    Raises:
        RecordingError: the disk is full; a later attempt can finish the runs without loss.
    """
    recovered: list[Path] = []
    for folder in _unfinished(runs):
        try:
            if _of_later(folder):
                continue  # this version does not know the format of the run
            lock = lock_folder(folder)
            if lock is None:
                continue  # another process is writing this run
            try:
                done = _recover_folder(folder)
            finally:
                os.close(lock)
        except OSError as error:
            raise RecordingError(f"{folder}: cannot be recovered: {error.strerror}") from None
        if done is not None:
            recovered.append(done)
    _recover_videos(runs)
    return recovered


def _unfinished(runs: Path) -> list[Path]:
    """Return the folders of unfinished runs; links and files are left out."""
    return sorted(path for path in runs.glob(f"*{PARTIAL_SUFFIX}") if path.is_dir() and not path.is_symlink())


def _recover_videos(runs: Path) -> None:
    """Finish the videos of cameras that were killed, also those of complete runs."""
    for left in sorted(runs.glob(f"*/{VIDEOS_FOLDER}/*{RECORDING_SUFFIX}{PARTIAL_SUFFIX}")):
        if not is_regular(left) or left.parent.is_symlink() or left.parent.parent.is_symlink():
            continue  # a link may point to files of another program
        try:
            recover_file(left)
        except BlockingIOError:
            continue  # a camera is writing this video
        except OSError as error:
            raise RecordingError(f"{left}: cannot be recovered: {error.strerror}") from None


def unrecoverable(runs: Path) -> list[str]:
    """Return a message with instructions for each interrupted run that only a later ctr-station can finish."""
    return [
        f"{folder}: interrupted, and not recovered: {why}" for folder in _unfinished(runs) if (why := _of_later(folder))
    ]


def _of_later(folder: Path) -> str:
    """Return why this version of ctr-station cannot finish the recordings in a folder; empty if it can."""
    for path in sorted(folder.glob(f"*{RECORDING_SUFFIX}*")):
        with contextlib.suppress(OSError), open_in(folder, path.name) as file:
            if later := is_later(_run(file)):
                return f"{path.name}: {later}"
    return ""


def _left(folder: Path) -> list[Path]:
    left = (*folder.glob(f"*{RECORDING_SUFFIX}{PARTIAL_SUFFIX}"), *folder.glob(f"*{RECORDING_SUFFIX}{FULL_SUFFIX}"))
    return sorted(filter(is_regular, left))


def _run(file: IO[bytes]) -> Mapping[str, Any]:
    """Return the metadata record `run` of an incomplete recording; empty if the file ends before this record."""
    try:
        for record in StreamReader(file).records:
            if isinstance(record, Metadata) and record.name == RUN_RECORD:
                return values_of(record.metadata)
            if isinstance(record, Chunk):
                break
    except (McapError, ValueError, struct.error):
        pass  # the file ends before the metadata record
    return {}


def recover_file(left: Path) -> Path | None:
    """Finish one recording of a killed writer and return its path; None if nothing had reached the disk.

    Raises:
        OSError: the file cannot be written.
    """
    suffix = FULL_SUFFIX if left.name.endswith(FULL_SUFFIX) else PARTIAL_SUFFIX
    label = RunOutcome.INCOMPLETE if suffix == FULL_SUFFIX else RunOutcome.INTERRUPTED
    result = {"label": label, "cause": CAUSES[label], "ended": left.stat().st_mtime}
    try:
        finish_file(left, texts(result), verify=True)
    except RecordingError:
        left.unlink()
        return None
    whole = left.with_name(left.name.removesuffix(suffix))
    left.rename(whole)
    return whole


def _recover_folder(folder: Path) -> Path | None:
    for left in _left(folder):
        recover_file(left)
    found = recordings(folder)
    if not found:
        if {path.name for path in folder.iterdir()} <= RUN_FILES:  # otherwise it is a folder of the user
            shutil.rmtree(folder)
        return None
    if not (folder / SUMMARY_FILE).exists():
        write_json(folder / SUMMARY_FILE, _summary(found))
    target = folder.with_name(folder.name.removesuffix(PARTIAL_SUFFIX))
    number = 2
    while target.exists():
        target, number = folder.with_name(f"{folder.name.removesuffix(PARTIAL_SUFFIX)}-{number}"), number + 1
    folder.rename(target)
    return target


def _summary(found: list[Path]) -> Mapping[str, Any]:
    """Return a summary of a recovered run, computed from its recordings."""
    cases: dict[str, Any] = {}
    labels: list[RunOutcome] = []
    run: Mapping[str, Any] = {}
    for path in found:
        try:
            with open_case(path) as case:
                run = case.metadata
                labels.append(case.label)
                cases[path.stem] = {"completed": case.label is RunOutcome.COMPLETE, "cause": case.cause}
        except RecordingError as error:  # one damaged recording must not prevent the station's start
            cases[path.stem] = {"completed": False, "cause": str(error)}
    # The run is never labelled complete: it did not reach its end, even if all recorded cases did.
    label = RunOutcome.INCOMPLETE if RunOutcome.INCOMPLETE in labels else RunOutcome.INTERRUPTED
    kept = {key: run[key] for key in ("experiment", "title", "seed", "started") if key in run}
    return json.loads(json.dumps({**kept, "label": label, "cause": CAUSES[label], "completed": False, "cases": cases}))
