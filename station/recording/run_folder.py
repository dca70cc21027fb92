"""Folder of a run with `<case>.mcap`, `experiment.toml` and `summary.json`; it gets its name when the run has ended."""

import contextlib
import errno
import fcntl
import itertools
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from station.recording.data_section import sync_folder
from station.recording.run_outcome import RecordingError
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX
from station.regular_file import is_hidden, is_regular, open_folder, read_in

SUMMARY_FILE = "summary.json"
EXPERIMENT_FILE = "experiment.toml"
REPORT_FILE = "report.html"
#: File in the folder of a run that has not ended. Only a folder with this file, which starts with `MARK`, is recovered.
MARK_FILE, MARK = ".unfinished-run", "ctr-station: "
MARK_TEXT = f"{MARK}this run has not ended. If its station ended, the next start of ctr-station finishes it.\n"
RECORDING_SUFFIX = ".mcap"
#: Folder in the run's folder with the videos of the cameras, `NAME.mcap`; it is separate, because every file
#: `*.mcap` in the run's folder is a case.
VIDEOS_FOLDER = "cameras"
#: File name of the only recording of a live run; the metadata have the name of the experiment's case.
LIVE_CASE = "run"
#: Largest growth of a recording [bytes/s]: 500 rows of about 180 numbers that cannot be compressed, and 10 drawings.
#: A real run needs about half of this.
RECORDING_BYTES_PER_S = 400_000.0
#: Disk space that stays free for other programs [bytes].
FREE_SPACE_BYTES = 100e6
#: Number of characters of a file's name that its provisional name contains; a name has at most 255 bytes.
MAX_STEM_CHARS = 50
#: Longest wait of a change of a run until another change has finished [s], and interval of the attempts [s].
CHANGE_PATIENCE_S, CHANGE_POLL_S = 5.0, 0.005


class RunFolder:
    """Folder of one run; until it is finished it has a provisional name and is locked."""

    def __init__(self, runs: Path, name: str) -> None:
        """Create the folder of the run under its provisional name.

        Raises:
            RecordingError: `runs` cannot be written to.
        """
        self._runs = runs
        with self._written():
            runs.mkdir(parents=True, exist_ok=True)
            for number in itertools.count(1):
                self.path = runs / (name if number == 1 else f"{name}-{number}")  #: final path of the run's folder
                #: Path of the folder until the run is finished.
                self.partial = self.path.with_name(self.path.name + PARTIAL_SUFFIX)
                try:
                    self.partial.mkdir()
                except FileExistsError:
                    continue
                self._lock = lock_folder(self.partial)
                try:
                    if self._lock is not None and not os.path.lexists(self.path):
                        self._mark()
                        break
                except OSError:
                    self._give_up()
                    raise
                self._give_up()
        self.started = time.time()  #: start of the run [s since 1970]

    def _mark(self) -> None:
        """Write the mark, and flush it to the disk, because a run without it is not recovered after a power cut."""
        with (self.partial / MARK_FILE).open("x", encoding="utf-8") as file:
            file.write(MARK_TEXT)
            file.flush()
            os.fsync(file.fileno())
        sync_folder(self.partial)
        sync_folder(self._runs)

    def _give_up(self) -> None:
        """Unlock and remove the new folder, unless something else is in it."""
        self.let_go()
        with contextlib.suppress(OSError):
            (self.partial / MARK_FILE).unlink(missing_ok=True)
            self.partial.rmdir()

    def add_source(self, text: str) -> None:
        """Write the experiment's file into the folder.

        Raises:
            RecordingError: the file cannot be written.
        """
        with self._written():
            (self.partial / EXPERIMENT_FILE).write_text(text, encoding="utf-8")

    def case(self, name: str) -> Path:
        """Return the path for the recording of a case, in the unfinished folder."""
        return self.partial / f"{name}{RECORDING_SUFFIX}"

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write the summary and give the folder its final name.

        Raises:
            RecordingError: the summary cannot be written, or a recording is unfinished because the disk was full; the
                next recovery finishes the folder.
        """
        try:
            with self._written():
                write_json(self.partial / SUMMARY_FILE, summary)
                if left := unfinished_recordings(self.partial):
                    raise RecordingError(f"{self.partial}: {left[0].name} is not finished; the next start recovers it")
                self.partial.rename(self.path)
                (self.path / MARK_FILE).unlink(missing_ok=True)
                sync_folder(self._runs)
        finally:
            self.let_go()

    def let_go(self) -> None:
        """Unlock the unfinished folder; the next recovery finishes it, or removes it if it has no recording."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(f"{self._runs}: cannot write results: {error.strerror}") from None


def lock_folder(folder: Path) -> int | None:
    """Lock a folder and return the descriptor of the lock; None: another process has locked or removed it.

    The lock ends when the descriptor is closed or this process ends.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
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


@contextmanager
def locked_for_change(folder: Path) -> Iterator[None]:
    """Lock the folder of a finished run, so that no other thread or process changes it during the block.

    Raises:
        FileNotFoundError: the folder does not exist, or was moved or removed before it could be locked.
        OSError: the folder is a link, or another program has locked it for longer than `CHANGE_PATIENCE_S`.
    """
    until = time.monotonic() + CHANGE_PATIENCE_S
    with open_folder(folder) as descriptor:
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > until:
                    text = f"another program has been changing it for {CHANGE_PATIENCE_S:g} s"
                    raise BlockingIOError(errno.EAGAIN, text, folder) from None
                time.sleep(CHANGE_POLL_S)
        try:
            if not os.path.samestat(os.fstat(descriptor), folder.lstat()):
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), folder)
            yield
        finally:
            fcntl.flock(descriptor, fcntl.LOCK_UN)


def write_json(path: Path, value: Any) -> None:
    """Replace a JSON file atomically.

    Raises:
        OSError: the file cannot be written, for example because the disk is full.
    """
    write_atomically(json.dumps(value, indent=1) + "\n", path)


def write_atomically(text: str, path: Path) -> Path:
    """Replace a file by a text atomically: readers see the old file or the complete new one.

    Several threads or processes may write the same file at the same time; the last one wins.

    Raises:
        OSError: the file cannot be written, for example because the disk is full.
    """
    with replacing(path) as whole:
        whole.write_text(text, encoding="utf-8")
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide the path of an empty new file, which replaces `path` after the block; after an error it is removed.

    Its name differs from that of every other file, so nothing of the user is overwritten or in the way.

    Raises:
        OSError: the file cannot be created, or cannot replace `path`.
    """
    whole = path.with_name(f"{_provisional_stem(path)}{secrets.token_hex(8)}{PARTIAL_SUFFIX}")
    whole.open("xb").close()  # outside of `try`: a file that exists is not ours to remove
    try:
        yield whole
        whole.replace(path)
    except BaseException:
        whole.unlink(missing_ok=True)
        raise


def is_provisional(path: Path, final: Path) -> bool:
    """Return whether the name of a file is one that `replacing` gives to a new version of `final`."""
    expression = rf"{re.escape(_provisional_stem(final))}[0-9a-f]{{16}}{re.escape(PARTIAL_SUFFIX)}"
    return re.fullmatch(expression, path.name) is not None


def _provisional_stem(path: Path) -> str:
    return f".{path.name[:MAX_STEM_CHARS]}-"


def free_path(path: Path, suffix: str = "") -> Path:
    """Return the path of a new file or folder: `path`, or with the first free number, for example `a-2.mcap`."""
    found, numbers = path, itertools.count(2)
    while os.path.lexists(found):
        found = path.with_name(f"{path.name.removesuffix(suffix)}-{next(numbers)}{suffix}")
    return found


def recordings(folder: Path) -> list[Path]:
    """Return the recordings of a run's cases, sorted by name; links, hidden files and names not UTF-8 are left out."""
    return _files(folder, f"*{RECORDING_SUFFIX}")


def unfinished_recordings(folder: Path) -> list[Path]:
    """Return the recordings in a folder that are being written, or whose writer was killed or had a full disk."""
    return [
        path
        for suffix in (FULL_SUFFIX, PARTIAL_SUFFIX)
        for path in _files(folder, f"*{RECORDING_SUFFIX}{suffix}")
    ]  # fmt: skip


def is_unfinished_run(folder: Path) -> bool:
    """Return whether a folder is that of a run that has not ended: it has the provisional name and the mark."""
    try:
        return (
            folder.name.removesuffix(PARTIAL_SUFFIX) not in ("", folder.name)
            and not folder.is_symlink()
            and read_in(folder, MARK_FILE).startswith(MARK.encode())
        )
    except OSError:
        return False


def _files(folder: Path, pattern: str) -> list[Path]:
    """Return regular files; macOS writes a hidden file `._NAME` next to each file of some disks."""
    return sorted(
        path for path in folder.glob(pattern) if not is_hidden(path) and has_utf8_name(path) and is_regular(path)
    )


def video_files(folder: Path) -> list[Path]:
    """Return the finished videos of a run, sorted by name; links are left out."""
    inside = folder / VIDEOS_FOLDER
    return [] if inside.is_symlink() else _files(inside, f"*{RECORDING_SUFFIX}")


def has_utf8_name(path: Path) -> bool:
    """Return whether the file name is valid UTF-8."""
    try:
        path.name.encode()
    except UnicodeEncodeError:
        return False
    return True


def free_space_problem(folder: Path, duration: float, videos: float = 0.0) -> str:
    """Return why a recording does not fit into `folder`, with what to do; empty if it fits.

    Args:
        folder: folder of the runs.
        duration: duration of the recording [s].
        videos: largest growth of the cameras' videos [bytes/s].
    """
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    if not os.access(existing, os.W_OK):
        return f"{folder}: recordings cannot be written; choose another folder or change its permissions"
    free, needed = shutil.disk_usage(existing).free, (RECORDING_BYTES_PER_S + videos) * duration + FREE_SPACE_BYTES
    if free >= needed:
        return ""
    return (
        f"{folder}: {free / 1e6:.0f} MB are free, a recording of {duration:g} s needs {needed / 1e6:.0f} MB;"
        " delete old runs or shorten this one"
    )
