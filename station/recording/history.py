"""Access to stored runs: find a run by name, list the runs, annotate and delete them."""

import contextlib
import errno
import json
import math
import os
import stat
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from station.config.strict import Strict, has_control_characters, text_of
from station.recording.deletion import RECORD_FILE, TRASH, remove_due, write_deletion
from station.recording.headline import Headline, headline
from station.recording.read import open_case
from station.recording.run_folder import (
    SUMMARY_FILE,
    has_utf8_name,
    locked_for_change,
    recordings,
    video_files,
    write_json,
)
from station.recording.run_outcome import CaseOutcome, RecordingError, case_outcomes
from station.recording.writer import PARTIAL_SUFFIX
from station.regular_file import is_hidden, is_regular, open_folder, read_in

#: Name of the file with the title, star, tags and notes that the user has added to a run.
NOTES_FILE = "notes.json"
#: Name of the file with the results of a sweep.
SWEEP_FILE = "sweep.json"
#: Name for the newest run, accepted instead of its identifier.
LATEST = "latest"
#: Largest plausible start time in a summary [s since 1970].
MAX_START_TIME = 1e11
#: Longest notes about a run, longest title and longest tag [characters]; largest number of tags of a run.
MAX_NOTES_CHARS, MAX_TITLE_CHARS, MAX_TAG_CHARS, MAX_TAGS = 20_000, 120, 40, 20


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
    headline: Headline | None = None
    """main number of the run's result; null if there is none"""
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

    def __init__(self, runs: Path, *, may_be_link: bool = True) -> None:
        """Prepare the access. `may_be_link`: whether `runs` may be a link; if not, a link counts as an empty folder."""
        self._runs, self._may_be_link = runs, may_be_link

    def deleted(self) -> "RunHistory":
        """Return the access to the deleted runs, which can be restored for a day."""
        return RunHistory(self._runs / TRASH, may_be_link=False)

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
        """Return the path of a case's recording; `case` may be empty if the run has only one case.

        Raises:
            NoRunError: there is no such run or case, or the run has several cases and none was named.
        """
        folder = self.find(name)
        cases = {path.stem: path for path in recordings(folder)}
        if case in cases:
            return cases[case]
        if not case and len(cases) == 1:
            return next(iter(cases.values()))
        reason = f"'{case}' is not one of the cases" if case else "choose one of the cases" if cases else "no recording"
        raise NoRunError(f"run '{folder.name}': {reason}{': ' if cases else ''}{', '.join(cases)}")

    def settings(self, name: str, case: str = "") -> "RunSettings":
        """Return the settings of a recorded case; `case` may be omitted as in `recording`.

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
        """Replace notes, title, star or tags of a run and return its entry; None leaves a value unchanged.

        An empty title restores the recorded one. The recording itself is never changed.

        Raises:
            RunError: there is no such run, a text is too long, there are too many tags, or the disk is full.
        """
        folder = self.find(name)
        _check_text("notes", notes, MAX_NOTES_CHARS, line=False)
        _check_text("title", title, MAX_TITLE_CHARS)
        for tag in tags or ():
            _check_text(f"tag {tag[:MAX_TAG_CHARS]!r}", tag, MAX_TAG_CHARS)
        if tags is not None and len(tags) > MAX_TAGS:
            raise RunError(f"{len(tags)} tags; a run has at most {MAX_TAGS}, remove some")
        changes = {"notes": notes, "title": title, "starred": starred, "tags": None if tags is None else list(tags)}
        with self._changing(folder, "its notes cannot be changed"):
            known = _added(folder)
            write_json(folder / NOTES_FILE, known | {key: to for key, to in changes.items() if to is not None})
        return self._details(folder)

    def delete(self, name: str, confirm: str) -> None:
        """Move a run to the deleted runs, and remove runs that were deleted more than a day ago.

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
        with self._changing(folder, "it cannot be deleted"):
            trash.mkdir(exist_ok=True)
            with open_folder(trash) as deleted:  # fails if it is a link
                os.rename(folder, folder.name, dst_dir_fd=deleted)
            # A deleted run without a record, for example because the disk is full, stays until it is restored.
            with contextlib.suppress(OSError):
                write_deletion(trash / folder.name)

    def purge(self) -> None:
        """Remove the runs that were deleted more than a day ago from the disk (`recording/deletion.py`).

        Raises:
            RunError: a deleted run cannot be removed.
        """
        try:
            remove_due(self._runs / TRASH)
        except OSError as error:
            where = self._runs / TRASH
            raise RunError(f"{where}: runs deleted more than a day ago cannot be removed: {error.strerror}") from None

    def restore(self, name: str) -> RunDetails:
        """Move a deleted run back and return its entry.

        Raises:
            RunError: there is no such deleted run, or it cannot be moved.
        """
        folder = self.deleted().find(name)
        with self._changing(folder, "it cannot be restored"):
            target = self._runs / folder.name
            if os.path.lexists(target):
                raise FileExistsError(errno.EEXIST, f"{target} exists", target)
            folder.rename(target)
            with contextlib.suppress(OSError):
                (target / RECORD_FILE).unlink(missing_ok=True)
        return self.run(folder.name)

    @contextmanager
    def _changing(self, folder: Path, failure: str) -> Iterator[None]:
        """Lock the folder of a run during the block.

        Raises:
            NoRunError: the run has been removed.
            RunError: an OSError of the lock or of the block, with `failure` and the reason.
        """
        try:
            with locked_for_change(folder):
                yield
        except OSError as error:
            if not os.path.lexists(folder):
                raise NoRunError(f"run '{folder.name}' has been removed from {folder.parent}") from None
            raise RunError(f"run '{folder.name}': {failure}: {error.strerror}") from None

    def _details(self, folder: Path) -> RunDetails:
        found = _run_entry(folder)
        if found is None:
            raise NoRunError(f"run '{folder.name}' has been removed from {self._runs}, or cannot be read")
        return found

    def _folders(self) -> Iterator[Path]:
        """Yield the folders of finished runs; links, names not in UTF-8, hidden and unreadable ones are skipped."""
        if not self._runs.is_dir() or (self._runs.is_symlink() and not self._may_be_link):
            return
        for folder in self._runs.iterdir():
            if (
                folder.name.endswith(PARTIAL_SUFFIX)
                or folder.name == TRASH
                or is_hidden(folder)
                or not has_utf8_name(folder)
                or folder.is_symlink()
                or not folder.is_dir()
            ):
                continue
            with contextlib.suppress(OSError):
                if any(is_regular(folder / name) for name in (SUMMARY_FILE, SWEEP_FILE)) or recordings(folder):
                    yield folder


def resolve_run(name: str, runs: Path) -> Path:
    """Return the folder of a run, given as a folder, as a name in `runs` or as `latest`.

    Raises:
        RunError: there is no such run.
    """
    folder = Path(name)
    if folder.is_dir() and name != LATEST:
        return folder.resolve() if folder.is_symlink() else folder
    return RunHistory(runs).find(name)


def _run_entry(folder: Path) -> RunDetails | None:
    """Return the entry of the run in a folder; None if the folder has just been removed or cannot be read."""
    summary, added = _json(folder, SUMMARY_FILE), _json(folder, NOTES_FILE)
    tags = added.get("tags", [])
    started = summary.get("started")
    try:
        if not isinstance(started, int | float) or abs(started) >= MAX_START_TIME:
            started = folder.stat().st_mtime
        cases = tuple(path.stem for path in recordings(folder))
        videos = [path for path in video_files(folder) if has_utf8_name(path)]
        size = sum(map(_size, (*folder.iterdir(), *videos)))
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
        headline=headline(summary),
        outcomes=case_outcomes(summary),
        summary=summary,
        videos=tuple(path.stem for path in videos),
    )


def _check_text(what: str, text: str | None, most: int, *, line: bool = True) -> None:
    """Check the length of a text, and that it has no control characters if it must be one line; raises RunError."""
    if text is not None and len(text) > most:
        raise RunError(f"{what}: {len(text)} characters; at most {most} are allowed")
    if text is not None and line and has_control_characters(text):
        raise RunError(f"{what}: line breaks and other control characters are not allowed; remove them")


def _added(folder: Path) -> dict[str, Any]:
    """Return title, star, tags and notes that the user has added to a run; empty if there are none.

    Raises:
        OSError: the file cannot be read, or is damaged, so that a change would lose its content.
    """
    try:
        content = read_in(folder, NOTES_FILE)
    except FileNotFoundError:
        return {}
    try:
        return _object(content)
    except (ValueError, RecursionError):
        raise OSError(errno.EINVAL, f"{NOTES_FILE} is damaged; repair or remove it", folder / NOTES_FILE) from None


def _json(folder: Path, name: str) -> dict[str, Any]:
    """Return the JSON object in a file of a run; empty if the file is invalid or missing."""
    try:
        return _object(read_in(folder, name))
    except (OSError, ValueError, RecursionError):
        return {}


def _object(content: bytes) -> dict[str, Any]:
    """Return the JSON object in a file; NaN and infinity become null.

    Raises:
        ValueError, RecursionError: the file is not a JSON object that can be sent as UTF-8.
    """
    found = json.loads(text_of(content), parse_constant=lambda _: None, parse_float=_finite)
    json.dumps(found, ensure_ascii=False).encode()  # raises for a lone surrogate, which is not valid text
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    return found


def _size(path: Path) -> int:
    """Return the size of a regular file [bytes]; 0 for anything else, and for a file that has just been removed."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return 0
    return status.st_size if stat.S_ISREG(status.st_mode) else 0


def _finite(text: str) -> float | None:
    number = float(text)
    return number if math.isfinite(number) else None
