"""Recordings whose writer was killed: cut after the last whole chunk, indexed, labelled, given their names.

Done at the next start. Killed in the middle it is simply done again: chunks are never touched.
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

from station.recording.label import Label, RecordingError
from station.recording.metadata import RUN, is_later, texts, values_of
from station.recording.read import open_case
from station.recording.run_folder import RECORDING, SUMMARY, lock_folder, write_json
from station.recording.summary import finish_file
from station.recording.writer import FULL, PARTIAL

CAUSES = {
    Label.INTERRUPTED: "the process that recorded it was gone; recovered up to the last chunk that reached the disk",
    Label.INCOMPLETE: "the disk took no more",
}


def recover(runs: Path) -> list[Path]:
    """Finish every run that nobody is writing any more, but those of a later ctr-station: `left_alone` names them.

    Args:
        runs: the folder of runs; it need not exist.

    Returns:
        The folders that have got their names.

    Raises:
        RecordingError: the disk has no room; nothing is lost by trying again later.
    """
    recovered: list[Path] = []
    for folder in sorted(runs.glob(f"*{PARTIAL}")):
        try:
            if _of_later(folder):
                continue  # what it means is not known here
            lock = lock_folder(folder)
            if lock is None:
                continue  # being written
            try:
                done = _recover_folder(folder)
            finally:
                os.close(lock)
        except OSError as error:
            raise RecordingError(f"{folder}: cannot be recovered: {error.strerror}") from None
        if done is not None:
            recovered.append(done)
    return recovered


def left_alone(runs: Path) -> list[str]:
    """Of each run that was cut off and that only a later ctr-station can finish: which, and what to do about it."""
    return [
        f"{folder}: cut off, and not recovered: {why}"
        for folder in sorted(runs.glob(f"*{PARTIAL}"))
        if (why := _of_later(folder))
    ]


def _of_later(folder: Path) -> str:
    """Why what was left in a folder cannot be finished here; empty when it can."""
    for path in sorted(folder.glob(f"*{RECORDING}*")):
        with contextlib.suppress(OSError), path.open("rb") as file:
            if later := is_later(_run(file)):
                return f"{path.name}: {later}"
    return ""


def _left(folder: Path) -> list[Path]:
    return sorted((*folder.glob(f"*{RECORDING}{PARTIAL}"), *folder.glob(f"*{RECORDING}{FULL}")))


def _run(file: IO[bytes]) -> Mapping[str, Any]:
    """What a recording that ends anywhere says of its run, before its rows; empty when it does not come to that."""
    try:
        for record in StreamReader(file).records:
            if isinstance(record, Metadata) and record.name == RUN:
                return values_of(record.metadata)
            if isinstance(record, Chunk):
                break
    except (McapError, ValueError, struct.error):
        pass  # cut off before
    return {}


def recover_file(left: Path) -> Path | None:
    """Finish one recording that was left behind; None when nothing of it had reached the disk.

    Raises:
        OSError: it cannot be written.
    """
    suffix = FULL if left.name.endswith(FULL) else PARTIAL
    label = Label.INCOMPLETE if suffix == FULL else Label.INTERRUPTED
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
    recordings = sorted(folder.glob(f"*{RECORDING}"))
    if not recordings:
        shutil.rmtree(folder)
        return None
    if not (folder / SUMMARY).exists():
        write_json(folder / SUMMARY, _summary(recordings))
    place = folder.with_name(folder.name.removesuffix(PARTIAL))
    number = 2
    while place.exists():
        place, number = folder.with_name(f"{folder.name.removesuffix(PARTIAL)}-{number}"), number + 1
    folder.rename(place)
    return place


def _summary(recordings: list[Path]) -> Mapping[str, Any]:
    """What the recordings themselves say of the run."""
    cases: dict[str, Any] = {}
    labels: list[Label] = []
    run: Mapping[str, Any] = {}
    for path in recordings:
        try:
            with open_case(path) as case:
                run = case.metadata
                labels.append(case.label)
                cases[path.stem] = {"completed": case.label is Label.COMPLETE, "cause": case.cause}
        except RecordingError as error:  # the others are worth keeping, and the station is to start
            cases[path.stem] = {"completed": False, "cause": str(error)}
    # The run itself did not get to its end, whatever its cases did.
    label = Label.INCOMPLETE if Label.INCOMPLETE in labels else Label.INTERRUPTED
    kept = {key: run[key] for key in ("experiment", "title", "seed", "started") if key in run}
    return json.loads(json.dumps({**kept, "label": label, "cause": CAUSES[label], "completed": False, "cases": cases}))
