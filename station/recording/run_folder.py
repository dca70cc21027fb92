"""The folder of a run: `<case>.mcap`, `experiment.toml`, `summary.json`; it gets its name when all is in it."""

import contextlib
import fcntl
import itertools
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from station.recording.data_section import sync_folder
from station.recording.label import RecordingError
from station.recording.writer import PARTIAL

SUMMARY = "summary.json"
EXPERIMENT = "experiment.toml"
RECORDING = ".mcap"


class RunFolder:
    """A folder of its own for a run, under a provisional name and locked until it is finished."""

    def __init__(self, runs: Path, name: str) -> None:
        """Make it.

        Raises:
            RecordingError: `runs` cannot be written to.
        """
        self._runs = runs
        with self._written():
            runs.mkdir(parents=True, exist_ok=True)
            for number in itertools.count(1):
                self.path = runs / (name if number == 1 else f"{name}-{number}")  #: its final place
                self.partial = self.path.with_name(self.path.name + PARTIAL)  #: its place until then
                try:
                    self.partial.mkdir()
                except FileExistsError:
                    continue
                # A recovery of another process may have seen it empty and unlocked.
                self._lock = lock_folder(self.partial)
                if self._lock is not None and not self.path.exists():
                    break
                self.let_go()
                with contextlib.suppress(FileNotFoundError):
                    self.partial.rmdir()
        self.started = time.time()  #: [s] since 1970

    def add_source(self, text: str) -> None:
        """Keep the experiment's file beside the recordings.

        Raises:
            RecordingError: the disk does not take it.
        """
        with self._written():
            (self.partial / EXPERIMENT).write_text(text, encoding="utf-8")

    def case(self, name: str) -> Path:
        """Where the recording of a case goes."""
        return self.partial / f"{name}{RECORDING}"

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Add the summary; then the folder gets its name.

        Raises:
            RecordingError: the disk does not take it, or did not take the end of a recording; the next
                recovery finishes the folder.
        """
        try:
            with self._written():
                write_json(self.partial / SUMMARY, summary)
                if left := [path.name for path in self.partial.glob(f"*{RECORDING}.*")]:
                    raise RecordingError(f"{self.partial}: {left[0]} is not finished; the next start recovers it")
                self.partial.rename(self.path)
                sync_folder(self._runs)
        finally:
            self.let_go()

    def let_go(self) -> None:
        """Leave the folder as it is; the next recovery finishes it, or removes it when nothing was recorded."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(f"{self._runs}: cannot write results there: {error.strerror}") from None


def lock_folder(folder: Path) -> int | None:
    """Hold a folder until the descriptor is closed or this process ends; None: somebody has it or has removed it."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    if os.fstat(descriptor).st_nlink == 0:
        os.close(descriptor)
        return None
    return descriptor


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Replace a file at once: a reader sees the old one or the new one."""
    whole = path.with_name(path.name + ".new")
    whole.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
    whole.replace(path)
