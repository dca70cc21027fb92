"""Deleted runs: the record of a deletion, and the removal of runs that were deleted long enough ago.

The computer's clock may be wrong by days and may be corrected at any time. Therefore the age of a deletion is computed
from the time since the computer's start, which does not depend on the clock. After a restart of the computer only the
clock remains: a run is then removed a week after its deletion, and an implausible age is reset to zero.
"""

import contextlib
import fcntl
import os
import shutil
import time
from pathlib import Path

from station.config.strict import Strict
from station.recording.run_folder import write_json
from station.regular_file import NotRegularError, open_folder, open_regular

#: Name of the folder with the deleted runs, in the folder of the runs.
TRASH = "deleted"
#: Name of the file with the record of the deletion, in the folder of a deleted run.
RECORD_FILE = "deleted.json"
#: Time for which a deleted run can be restored [s].
TRASH_SPAN_S = 24 * 3600.0
#: Time after a deletion for which a run stays if the computer has restarted, and longest plausible age [s].
RESTARTED_SPAN_S, PLAUSIBLE_SPAN_S = 7 * 24 * 3600.0, 60 * 24 * 3600.0
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Deletion(Strict):
    """Record of a deletion; `deletion_now` creates one of the present moment, from which an age is computed."""

    run: str
    """name of the deleted run's folder"""
    time: float
    """time of the deletion by the computer's clock [s since 1970]"""
    boot: str
    """identifier of the start of the computer, which changes with each start; empty: unknown"""
    since_boot: float
    """time from this start of the computer to the deletion, including suspension [s]"""


def deletion_now(run: str) -> Deletion:
    """Return the record of a deletion at this moment."""
    try:
        boot = BOOT_ID.read_text(encoding="ascii").strip()
        since = time.clock_gettime(time.CLOCK_BOOTTIME)
    except (OSError, AttributeError):  # not on Linux
        boot, since = "", time.monotonic()
    return Deletion(run=run, time=time.time(), boot=boot, since_boot=since)


def is_due(deletion: Deletion, now: Deletion) -> bool:
    """Return whether a deletion is so old that the run has to be removed."""
    if deletion.boot and deletion.boot == now.boot:
        return now.since_boot - deletion.since_boot > TRASH_SPAN_S
    return RESTARTED_SPAN_S < now.time - deletion.time <= PLAUSIBLE_SPAN_S


def is_plausible(deletion: Deletion, now: Deletion) -> bool:
    """Return whether the age of a deletion is plausible: not negative, and not longer than `PLAUSIBLE_SPAN_S`."""
    return deletion.boot == now.boot != "" or 0.0 <= now.time - deletion.time <= PLAUSIBLE_SPAN_S


def write_deletion(folder: Path) -> None:
    """Write the record of a deletion into the run's folder among the deleted runs. Without a record the run stays.

    Raises:
        OSError: the record cannot be written.
    """
    write_json(folder / RECORD_FILE, deletion_now(folder.name).model_dump())


def remove_due(trash: Path) -> None:
    """Remove the runs whose record shows a deletion that is old enough; everything else in the folder stays.

    Raises:
        OSError: a run cannot be removed; all other due runs have been removed.
    """
    failed: OSError | None = None
    try:
        names = sorted(path.name for path in trash.iterdir()) if not trash.is_symlink() else []
    except (FileNotFoundError, NotADirectoryError):
        return
    for name in names:
        try:
            _remove_if_due(trash, name)
        except OSError as error:
            failed = failed or error
    if failed is not None:
        raise failed


def _remove_if_due(trash: Path, name: str) -> None:
    with contextlib.ExitStack() as opened:
        try:
            inside = opened.enter_context(open_folder(trash))
            run = opened.enter_context(open_folder(name, inside))
            fcntl.flock(run, fcntl.LOCK_EX | fcntl.LOCK_NB)  # a run that is being restored is locked
        except (NotRegularError, FileNotFoundError, BlockingIOError):
            return
        try:
            with open_regular(RECORD_FILE, run) as file:
                deletion = Deletion.model_validate_json(file.read())
            same = os.path.samestat(os.fstat(run), os.stat(name, dir_fd=inside, follow_symlinks=False))
        except (OSError, ValueError):
            return  # without a valid record, the station may not have deleted this run
        now = deletion_now(name)
        if deletion.run != name or not same:
            return
        if is_due(deletion, now):
            shutil.rmtree(name, dir_fd=inside)
        elif not is_plausible(deletion, now):
            write_deletion(trash / name)
