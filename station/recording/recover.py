"""Recovery of recordings whose writer was killed.

A recovery takes place when a command starts the next time. It writes a complete copy of each recording (`salvage.py`),
which then replaces the unfinished file. Until then this file is not changed, so a killed recovery can be repeated. Only
what this program has written is recovered: run folders with its mark, and videos with its first bytes.
"""

import contextlib
import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.records import Chunk, Metadata
from mcap.stream_reader import StreamReader

from station.recording.chunks import DAMAGE
from station.recording.data_section import sync_folder
from station.recording.metadata import RUN_RECORD, is_later, texts, values_of
from station.recording.read import missing_rows, open_case
from station.recording.run_folder import (
    EXPERIMENT_FILE,
    FREE_SPACE_BYTES,
    MARK_FILE,
    RECORDING_SUFFIX,
    SUMMARY_FILE,
    VIDEOS_FOLDER,
    free_path,
    is_provisional,
    is_unfinished_run,
    lock_folder,
    recordings,
    replacing,
    unfinished_recordings,
    write_json,
)
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.salvage import is_empty_recording, is_recording, salvage
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX
from station.regular_file import is_regular, open_in

CAUSES = {
    RunOutcome.INTERRUPTED: "the recording process ended; the intact rows that reached the disk were recovered",
    RunOutcome.INCOMPLETE: "the disk was full",
}


class Recovery(NamedTuple):
    """Result of a recovery."""

    folders: list[Path]  #: folders of the recovered runs, with their final names
    problems: list[str]  #: a message with instructions for each run or video that stays unfinished


def recover(runs: Path) -> Recovery:
    """Finish each run and video in `runs` that no process is writing; the folder `runs` need not exist."""
    found = Recovery([], [])
    for folder in sorted(filter(is_unfinished_run, runs.glob(f"*{PARTIAL_SUFFIX}"))):
        try:
            if later := _of_later(folder):
                found.problems.append(f"{folder}: interrupted, and not recovered: {later}")
                continue
            lock = lock_folder(folder)
            if lock is None:
                continue  # another process is writing this run
            try:
                done = _recover_folder(folder)
            finally:
                os.close(lock)
        except BlockingIOError:
            continue  # a process is still writing one of its recordings
        except (OSError, *DAMAGE) as error:
            found.problems.append(_problem(folder, error))
            continue
        if done is not None:
            found.folders.append(done)
    for folder in sorted(runs.glob(f"*/{VIDEOS_FOLDER}")):
        if not (folder.is_symlink() or folder.parent.is_symlink()):
            found.problems.extend(_recover_videos(folder))
    return found


def _recover_videos(folder: Path) -> Iterator[str]:
    """Finish the videos in a folder that no camera is writing; yield a message for each that stays unfinished."""
    left = unfinished_recordings(folder)
    lock = lock_folder(folder) if left else None
    if lock is None:
        return  # there is none, or another recovery finishes them
    try:
        for path in left:
            try:
                recover_file(path)
            except BlockingIOError:
                continue
            except (OSError, *DAMAGE) as error:
                yield _problem(path, error)
    finally:
        os.close(lock)


def _problem(path: Path, error: Exception) -> str:
    reason = error.strerror if isinstance(error, OSError) else repr(error)
    return (
        f"{path}: interrupted, and not recovered: {reason}. Nothing of it is lost: the next start of ctr-station"
        f" recovers it if it may write there and the disk has space for a copy and {FREE_SPACE_BYTES / 1e6:.0f} MB more"
    )


def _of_later(folder: Path) -> str:
    """Return why this version of ctr-station cannot finish the recordings in a folder; empty if it can."""
    for path in (*unfinished_recordings(folder), *recordings(folder)):
        with contextlib.suppress(OSError), open_in(folder, path.name) as file:
            if later := is_later(_run(file)):
                return f"{path.name}: {later}"
    return ""


def _run(file: IO[bytes]) -> Mapping[str, Any]:
    """Return the metadata record `run` of an incomplete recording; empty if the file ends before this record."""
    try:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Metadata) and record.name == RUN_RECORD:
                return values_of(record.metadata)
            if isinstance(record, Chunk):
                break
    except DAMAGE:
        pass  # the file ends before the metadata record, or is damaged there
    return {}


def recover_file(left: Path) -> Path | None:
    """Finish a recording of a killed writer and return its path. The caller has locked the file's folder.

    Return None if there is nothing to finish: this program has not written the file, its writer has just finished it,
    or was killed before anything reached the disk.

    Raises:
        BlockingIOError: a process is writing the file.
        OSError: the complete copy cannot be written; the file is unchanged.
    """
    suffix = FULL_SUFFIX if left.name.endswith(FULL_SUFFIX) else PARTIAL_SUFFIX
    label = RunOutcome.INCOMPLETE if suffix == FULL_SUFFIX else RunOutcome.INTERRUPTED
    try:
        source = open_in(left.parent, left.name)
    except FileNotFoundError:
        return None
    with source:
        fcntl.flock(source, fcntl.LOCK_EX | fcntl.LOCK_NB)
        status = os.fstat(source.fileno())
        try:
            if not os.path.samestat(status, left.lstat()) or not is_recording(source):
                return None
        except FileNotFoundError:
            return None
        _remove_copies(left)
        if shutil.disk_usage(left.parent).free < status.st_size + FREE_SPACE_BYTES:  # a run may be recording there
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), left)
        result = {"label": label, "cause": CAUSES[label], "ended": status.st_mtime}
        with replacing(left) as copy, copy.open("wb") as target:
            salvage(source, target, texts(result))
            os.fsync(target.fileno())
    whole = free_path(left.with_name(left.name.removesuffix(suffix)), RECORDING_SUFFIX)
    left.rename(whole)
    sync_folder(whole.parent)
    return whole


def _remove_copies(left: Path) -> None:
    """Remove the copies that killed recoveries of a recording have left behind."""
    for path in left.parent.iterdir():
        if is_provisional(path, left) and is_regular(path):
            with open_in(path.parent, path.name) as file:
                ours = is_recording(file) or is_empty_recording(file)
            if ours:
                path.unlink()


def _recover_folder(folder: Path) -> Path | None:
    for left in unfinished_recordings(folder):
        recover_file(left)
    found = recordings(folder)
    if not found and _removed(folder):
        return None
    if not (folder / SUMMARY_FILE).exists():
        write_json(folder / SUMMARY_FILE, _summary(folder, found))
    target = free_path(folder.with_name(folder.name.removesuffix(PARTIAL_SUFFIX)))
    folder.rename(target)
    (target / MARK_FILE).unlink()
    return target


def _removed(folder: Path) -> bool:
    """Remove the folder of a run that recorded nothing; return False if it has anything else, for example a note."""
    empty: list[Path] = []
    for left in unfinished_recordings(folder):
        with open_in(folder, left.name) as file:
            if is_empty_recording(file):
                empty.append(left)
    with contextlib.suppress(OSError):
        (folder / VIDEOS_FOLDER).rmdir()
    if {path.name for path in folder.iterdir()} - {path.name for path in empty} - {EXPERIMENT_FILE, MARK_FILE}:
        return False
    for path in (*empty, folder / EXPERIMENT_FILE, folder / MARK_FILE):
        path.unlink(missing_ok=True)
    folder.rmdir()
    return True


def _summary(folder: Path, found: list[Path]) -> Mapping[str, Any]:
    """Return a summary of a recovered run, computed from its recordings."""
    cases: dict[str, Any] = {}
    labels: list[RunOutcome] = []
    causes: list[str] = []
    run: Mapping[str, Any] = {}
    for path in found:
        try:
            with open_case(path) as case:
                run = case.metadata
                labels.append(case.label)
                missing = missing_rows(case.gaps())
                cause = "; ".join(filter(None, (case.cause, missing)))
                cases[path.stem] = {"completed": case.label is RunOutcome.COMPLETE, "cause": cause}
                causes += [f"{path.stem}: {missing}"] if missing else []
        except RecordingError as error:  # one damaged recording must not prevent the station's start
            cases[path.stem] = {"completed": False, "cause": str(error)}
    causes += [f"{left.name} cannot be read" for left in unfinished_recordings(folder)]
    # The run is never labelled complete: it did not reach its end, even if all recorded cases did.
    label = RunOutcome.INCOMPLETE if RunOutcome.INCOMPLETE in labels else RunOutcome.INTERRUPTED
    kept = {key: run[key] for key in ("experiment", "title", "seed", "started") if key in run}
    cause = "; ".join((CAUSES[label], *causes))
    return json.loads(json.dumps({**kept, "label": label, "cause": cause, "completed": False, "cases": cases}))
