"""Access to stored runs: find a run by name, list the runs, annotate and delete them."""

import contextlib
import json
import math
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from station.config.strict import Strict
from station.recording.read import open_case
from station.recording.run_folder import RECORDING_SUFFIX, SUMMARY_FILE, video_files, write_json
from station.recording.run_outcome import CaseOutcome, RecordingError, case_outcomes
from station.recording.writer import PARTIAL_SUFFIX

#: Name of the file with what the user has added to a run: title, star, tags and notes.
NOTES_FILE = "notes.json"
#: Name of the file with the results of a sweep.
SWEEP_FILE = "sweep.json"
#: Name for the newest run, accepted instead of its identifier.
LATEST = "latest"
#: Largest plausible start time in a summary [s since 1970].
MAX_START_TIME = 1e11
#: Longest notes about a run, longest title and longest tag [characters]; largest number of tags of a run.
MAX_NOTES_CHARS, MAX_TITLE_CHARS, MAX_TAG_CHARS, MAX_TAGS = 20_000, 120, 40, 20
#: Name of the folder with the deleted runs, in the folder of the runs.
TRASH = "deleted"
#: Time for which a deleted run can be restored [s].
TRASH_SPAN_S = 24 * 3600.0


class RunError(RecordingError):
    """A run does not exist, or the operation on it failed."""


class NoRunError(RunError):
    """The requested run or case does not exist."""


class RunEntry(Strict):
    """Entry of one run in the list of runs."""

    id: str
    """name of its folder"""
    experiment: str
    title: str
    label: str
    """complete, stopped, interrupted or incomplete"""
    cause: str
    """reason why it is not complete"""
    started: float
    """start time [s since 1970]"""
    cases: tuple[str, ...]
    """names of the cases with a recording"""
    size: int
    """size of its files [bytes]"""
    notes: str
    starred: bool = False
    tags: tuple[str, ...] = ()
    outcomes: Mapping[str, CaseOutcome] = {}
    """errors and force of each case that has them"""


class RunDetails(RunEntry):
    """Entry of a run with its whole summary: errors, counts and timing, if the run has them."""

    summary: Mapping[str, Any]
    videos: tuple[str, ...] = ()
    """names of the cameras' videos"""


class RunSettings(Strict):
    """Settings of a recorded case."""

    experiment: str
    """name of the experiment; empty: a free motion"""
    case: str
    """case of the experiment"""
    settings: Mapping[str, Any]
    """trajectory, controller, load, duration and more, SI"""


class RunHistory:
    """Access to all stored runs in one folder."""

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def deleted(self) -> "RunHistory":
        """Return the access to the deleted runs, which can be restored for a day."""
        return RunHistory(self._runs / TRASH)

    def runs(self, experiment: str = "", label: str = "", text: str = "") -> list[RunDetails]:
        """Return the stored runs, newest first.

        Args:
            experiment, label: return only runs with this experiment or label; empty: all runs.
            text: return only runs with this text in name, title, cause, tags or notes, ignoring upper and lower case.
        """
        found = [run for folder in self._folders() if (run := _run_entry(folder)) is not None]
        query = text.casefold()
        chosen = [
            run
            for run in found
            if experiment in ("", run.experiment)
            and label in ("", run.label)
            and query in " ".join((run.id, run.title, run.cause, *run.tags, run.notes)).casefold()
        ]
        # The computer's clock may have been set back. A run with a start in the future is listed as the oldest.
        now = time.time()
        return sorted(chosen, key=lambda run: (run.started <= now, run.started, run.id), reverse=True)

    def find(self, name: str) -> Path:
        """Return the folder of a run by its name; `latest` is the newest run.

        Raises:
            NoRunError: there is no such run.
        """
        if name == LATEST:
            newest = self.runs()
            if not newest:
                raise NoRunError(f"{self._runs}: the folder has no runs yet")
            return self._runs / newest[0].id
        # The name is compared with existing folders and never used as a path. So it cannot point outside the folder.
        for folder in self._folders():
            if folder.name == name:
                return folder
        raise NoRunError(f"'{name}' is not one of the runs in {self._runs}")

    def run(self, name: str) -> RunDetails:
        """Return the entry and summary of one run.

        Raises:
            NoRunError: there is no such run.
        """
        return self._details(self.find(name))

    def recording(self, name: str, case: str = "") -> Path:
        """Return the path of a case's recording; without a name, of the only case of the run.

        Raises:
            NoRunError: there is no such run or case, or the run has several cases and none was named.
        """
        folder = self.find(name)
        cases = {path.stem: path for path in _recordings(folder)}
        if case in cases:
            return cases[case]
        if not case and len(cases) == 1:
            return next(iter(cases.values()))
        reason = f"'{case}' is not one of the cases" if case else "choose one of the cases" if cases else "no recording"
        raise NoRunError(f"run '{folder.name}': {reason}{': ' if cases else ''}{', '.join(cases)}")

    def settings(self, name: str, case: str = "") -> "RunSettings":
        """Return what was recorded in a case; `case` may be omitted as in `recording`.

        Raises:
            RunError: there is no such run or case.
            RecordingError: the recording is damaged.
        """
        with open_case(self.recording(name, case)) as recorded:
            about = recorded.metadata
        return RunSettings(
            experiment=str(about.get("experiment", "")),
            case=str(about.get("case", "")),
            settings=dict(about.get("settings", {})),
        )

    def annotate(
        self, name: str, *, notes: str | None = None, title: str | None = None, starred: bool | None = None,
        tags: Sequence[str] | None = None,
    ) -> RunDetails:  # fmt: skip
        """Replace notes, title, star or tags of a run and return its entry; what is None stays as it is.

        An empty title restores the recorded one. The recording itself is never changed.

        Raises:
            RunError: there is no such run, a text is too long, there are too many tags, or the disk is full.
        """
        folder = self.find(name)
        _check_length("notes", notes, MAX_NOTES_CHARS)
        _check_length("title", title, MAX_TITLE_CHARS)
        for tag in tags or ():
            _check_length(f"tag '{tag[:MAX_TAG_CHARS]}'", tag, MAX_TAG_CHARS)
        if tags is not None and len(tags) > MAX_TAGS:
            raise RunError(f"{len(tags)} tags; a run has at most {MAX_TAGS}")
        changes = {"notes": notes, "title": title, "starred": starred, "tags": None if tags is None else list(tags)}
        changed = _json(folder / NOTES_FILE) | {key: value for key, value in changes.items() if value is not None}
        try:
            write_json(folder / NOTES_FILE, changed)
        except OSError as error:
            raise RunError(f"run '{folder.name}': notes cannot be written: {error.strerror}") from None
        return self._details(folder)

    def delete(self, name: str, confirm: str) -> None:
        """Move a run to the deleted ones, and remove those that were deleted more than a day ago.

        Args:
            name: name of the run; `latest` is refused, because another run may have become the latest.
            confirm: the same name again, as a confirmation.

        Raises:
            RunError: there is no such run, the deletion was not confirmed, or it failed.
        """
        folder = self.find(name) if name != LATEST else None
        if folder is None or confirm != folder.name:
            raise RunError(f"to delete run '{name}', confirm with the same name, not '{confirm}'")
        self.purge()
        trash = self._runs / TRASH
        try:
            trash.mkdir(exist_ok=True)
            os.utime(folder)  # the time of the deletion; set first, so that a purge never meets the older time
            folder.rename(trash / folder.name)
        except OSError as error:
            raise RunError(f"run '{folder.name}': cannot be deleted: {error.strerror}") from None

    def purge(self) -> None:
        """Remove the runs that were deleted more than a day ago from the disk.

        Raises:
            RunError: a deleted run cannot be removed.
        """
        trash = self._runs / TRASH
        try:
            for old in trash.iterdir() if trash.is_dir() else ():
                if not old.is_symlink() and time.time() - old.stat().st_mtime > TRASH_SPAN_S:
                    shutil.rmtree(old)
        except OSError as error:
            raise RunError(f"{trash}: runs deleted more than a day ago cannot be removed: {error.strerror}") from None

    def restore(self, name: str) -> RunDetails:
        """Move a deleted run back and return its entry.

        Raises:
            RunError: there is no such deleted run, or it cannot be moved.
        """
        folder = self.deleted().find(name)
        try:
            folder.rename(self._runs / folder.name)
        except OSError as error:
            raise RunError(f"run '{folder.name}': cannot be restored: {error.strerror}") from None
        return self.run(folder.name)

    def _details(self, folder: Path) -> RunDetails:
        found = _run_entry(folder)
        if found is None:
            raise NoRunError(f"run '{folder.name}' has been removed from {self._runs}, or cannot be read")
        return found

    def _folders(self) -> Iterator[Path]:
        """Yield the folders of finished runs; links, unreadable folders and names that are not UTF-8 are skipped."""
        if not self._runs.is_dir():
            return
        for folder in self._runs.iterdir():
            if (
                folder.name.endswith(PARTIAL_SUFFIX)
                or not _is_text(folder)
                or folder.is_symlink()
                or not folder.is_dir()
            ):
                continue
            with contextlib.suppress(OSError):
                if any((folder / name).is_file() for name in (SUMMARY_FILE, SWEEP_FILE)) or any(
                    folder.glob(f"*{RECORDING_SUFFIX}")
                ):
                    yield folder


def resolve_run(name: str, runs: Path) -> Path:
    """Return the folder of a run, given as a folder, as a name in `runs` or as `latest`.

    Raises:
        RunError: there is no such run.
    """
    folder = Path(name)
    if folder.is_dir() and name != LATEST:
        return folder
    return RunHistory(runs).find(name)


def _run_entry(folder: Path) -> RunDetails | None:
    """Return the entry of the run in a folder; None if the folder was removed meanwhile or cannot be read."""
    summary, added = _json(folder / SUMMARY_FILE), _json(folder / NOTES_FILE)
    tags = added.get("tags", [])
    started = summary.get("started")
    try:
        if not isinstance(started, int | float) or abs(started) >= MAX_START_TIME:
            started = folder.stat().st_mtime
        cases = tuple(path.stem for path in _recordings(folder))
        videos = video_files(folder)
        size = sum(path.stat().st_size for path in (*folder.iterdir(), *videos) if path.is_file())
    except OSError:
        return None
    return RunDetails(
        id=folder.name,
        experiment=str(summary.get("experiment", "")),
        title=str(added.get("title", "") or summary.get("title", "")),
        label=str(summary.get("label", "complete" if summary.get("completed") else "stopped")),
        cause=str(summary.get("cause", "")),
        started=float(started),
        cases=cases,
        size=size,
        notes=str(added.get("notes", "")),
        starred=added.get("starred") is True,
        tags=tuple(map(str, tags)) if isinstance(tags, list) else (),
        outcomes=case_outcomes(summary),
        summary=summary,
        videos=tuple(path.stem for path in videos),
    )


def _check_length(what: str, text: str | None, most: int) -> None:
    if text is not None and len(text) > most:
        raise RunError(f"{what}: {len(text)} characters; at most {most} are allowed")


def _json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file; empty if the file is invalid or missing. NaN and infinity become null."""
    try:
        text = path.read_text(encoding="utf-8")
        found = json.loads(text, parse_constant=lambda _: None, parse_float=_finite)
        json.dumps(found, ensure_ascii=False).encode()  # raises for a lone surrogate, which is not valid text
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _recordings(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob(f"*{RECORDING_SUFFIX}") if _is_text(path))


def _is_text(path: Path) -> bool:
    """Return whether the file name is valid UTF-8."""
    try:
        path.name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _finite(text: str) -> float | None:
    number = float(text)
    return number if math.isfinite(number) else None
