"""The runs that are kept: found by name, listed, annotated, thrown away."""

import contextlib
import json
import math
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from station.config.strict import Strict
from station.recording.label import RecordingError
from station.recording.outcome import CaseOutcome, outcomes
from station.recording.run_folder import RECORDING, SUMMARY, write_json
from station.recording.writer import PARTIAL

#: What a person wrote about a run.
NOTES = "notes.json"
#: What a sweep leaves beside the folders of its runs.
SWEEP = "sweep.json"
#: The newest run, wherever a name is asked for.
LATEST = "latest"
#: No run has started then, whatever a summary says [s since 1970].
LATER = 1e11
#: Longest notes [characters].
LONGEST = 20_000


class RunError(RecordingError):
    """No such run, or not to be done with it."""


class NoRunError(RunError):
    """A run or case that is not there."""


class Run(Strict):
    """A run at one look."""

    id: str
    """name of its folder"""
    experiment: str
    title: str
    label: str
    """complete, stopped, interrupted or incomplete"""
    cause: str
    """why it is not complete"""
    started: float
    """[s] since 1970"""
    cases: tuple[str, ...]
    """those with a recording"""
    size: int
    """[bytes]"""
    notes: str
    outcomes: Mapping[str, CaseOutcome] = {}
    """errors and force of each case that has them"""


class RunDetails(Run):
    """A run with its summary: errors, counts, timing, as far as the run has them."""

    summary: Mapping[str, Any]


class History:
    """Runs in one folder."""

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def runs(self, experiment: str = "", label: str = "", text: str = "") -> list[RunDetails]:
        """Runs, newest first.

        Args:
            experiment, label: only these; empty for all.
            text: only those with it in name, title, cause or notes; upper and lower case are the same.
        """
        found = [run for folder in self._folders() if (run := _look(folder)) is not None]
        words = text.casefold()
        chosen = [
            run
            for run in found
            if experiment in ("", run.experiment)
            and label in ("", run.label)
            and words in " ".join((run.id, run.title, run.cause, run.notes)).casefold()
        ]
        return sorted(chosen, key=lambda run: (run.started, run.id), reverse=True)

    def find(self, name: str) -> Path:
        """The folder of a run by its name; `latest` is the newest.

        Raises:
            NoRunError: there is no such run here.
        """
        if name == LATEST:
            newest = self.runs()
            if not newest:
                raise NoRunError(f"{self._runs}: no runs there yet")
            return self._runs / newest[0].id
        # Compared with what is there and never made into a path: a name cannot lead elsewhere.
        for folder in self._folders():
            if folder.name == name:
                return folder
        raise NoRunError(f"'{name}' is not one of the runs in {self._runs}")

    def run(self, name: str) -> RunDetails:
        """One run.

        Raises:
            NoRunError: there is no such run here.
        """
        return self._looked_at(self.find(name))

    def recording(self, name: str, case: str = "") -> Path:
        """The recording of a case; of the only one when no case is named.

        Raises:
            NoRunError: no such run or case, or several cases to choose from.
        """
        folder = self.find(name)
        cases = {path.stem: path for path in _recordings(folder)}
        if case in cases:
            return cases[case]
        if not case and len(cases) == 1:
            return next(iter(cases.values()))
        wrong = f"'{case}' is not one of the cases" if case else "choose one of the cases" if cases else "no recording"
        raise NoRunError(f"run '{folder.name}': {wrong}{': ' if cases else ''}{', '.join(cases)}")

    def set_notes(self, name: str, notes: str) -> RunDetails:
        """Replace a run's notes.

        Raises:
            RunError: no such run, too long, or the disk does not take them.
        """
        folder = self.find(name)
        if len(notes) > LONGEST:
            raise RunError(f"notes have {len(notes)} characters; at most {LONGEST} are kept")
        try:
            write_json(folder / NOTES, {"notes": notes})
        except OSError as error:
            raise RunError(f"run '{folder.name}': notes cannot be written: {error.strerror}") from None
        return self._looked_at(folder)

    def delete(self, name: str, confirm: str) -> None:
        """Remove a run for good.

        Args:
            name: of the run; `latest` is refused, it may be another one by now.
            confirm: the same name again.

        Raises:
            RunError: no such run, not confirmed, or it cannot be removed.
        """
        folder = self.find(name) if name != LATEST else None
        if folder is None or confirm != folder.name:
            raise RunError(f"to delete run '{name}' for good, confirm with its own name, not '{confirm}'")
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise RunError(f"run '{folder.name}': cannot be deleted: {error.strerror}") from None

    def _looked_at(self, folder: Path) -> RunDetails:
        found = _look(folder)
        if found is None:
            raise NoRunError(f"run '{folder.name}' has been removed from {self._runs}, or cannot be read")
        return found

    def _folders(self) -> Iterator[Path]:
        """Folders of finished runs; what cannot be read, and names that are not UTF-8, are left alone, as links are."""
        if not self._runs.is_dir():
            return
        for folder in self._runs.iterdir():
            if folder.name.endswith(PARTIAL) or not _is_text(folder) or folder.is_symlink() or not folder.is_dir():
                continue
            with contextlib.suppress(OSError):
                if any((folder / name).is_file() for name in (SUMMARY, SWEEP)) or any(folder.glob(f"*{RECORDING}")):
                    yield folder


def resolve_run(name: str, runs: Path) -> Path:
    """The folder of a run, given as a folder, as a name in `runs` or as `latest`.

    Raises:
        RunError: there is none.
    """
    folder = Path(name)
    if folder.is_dir() and name != LATEST:
        return folder
    return History(runs).find(name)


def _look(folder: Path) -> RunDetails | None:
    """What is in the folder; None: it has just been removed, or cannot be read."""
    try:
        return _run_in(folder)
    except OSError:
        return None


def _run_in(folder: Path) -> RunDetails:
    summary = _json(folder / SUMMARY)
    recordings = _recordings(folder)
    told = summary.get("started")
    return RunDetails(
        id=folder.name,
        experiment=str(summary.get("experiment", "")),
        title=str(summary.get("title", "")),
        label=str(summary.get("label", "complete" if summary.get("completed") else "stopped")),
        cause=str(summary.get("cause", "")),
        started=float(told) if isinstance(told, int | float) and abs(told) < LATER else folder.stat().st_mtime,
        cases=tuple(path.stem for path in recordings),
        size=sum(path.stat().st_size for path in folder.iterdir() if path.is_file()),
        notes=str(_json(folder / NOTES).get("notes", "")),
        outcomes=outcomes(summary),
        summary=summary,
    )


def _json(path: Path) -> dict[str, Any]:
    """A JSON object from a file; empty when a person has spoilt or removed it. NaN and infinity become null."""
    try:
        text = path.read_text(encoding="utf-8")
        found = json.loads(text, parse_constant=lambda _: None, parse_float=_finite)
        json.dumps(found, ensure_ascii=False).encode()  # half of a surrogate pair is no text
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _recordings(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob(f"*{RECORDING}") if _is_text(path))


def _is_text(path: Path) -> bool:
    """Whether the name is UTF-8."""
    try:
        path.name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _finite(text: str) -> float | None:
    number = float(text)
    return number if math.isfinite(number) else None
