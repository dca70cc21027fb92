"""Choice of the calibration that the station starts with, kept in the station file or until the program ends."""

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from station.config.strict import ConfigError, line_of, parse_toml, read_text, toml_lines
from station.control.states import RefusedError
from station.devices.registry import plan
from station.recording.run_folder import write_atomically
from station.service.station_file import load_station


class CalibrationChoice:
    """Choice of the calibration; a changed choice takes effect when the program starts the station again."""

    def __init__(self, config: Path | None = None, changes: Mapping[str, Any] | None = None) -> None:
        """Prepare the choice for the station file `config`; `changes` override keys of this file."""
        self.changes = dict(changes or {})  #: values that override keys of the station file
        #: Station file that receives the choice; None: no file, or the command line has set a calibration.
        self.file = None if config is None or "calibration" in self.changes else config.resolve()
        self._config = config
        self._undo: tuple[str, str] | dict[str, Any] | None = None  # file's text before and after, or `changes` before
        self.restart = threading.Event()  #: set when the station has to start again

    @property
    def can_undo(self) -> bool:
        """Whether the last choice can be undone."""
        return self._undo is not None

    def apply(self, folder: Path) -> None:
        """Choose the calibration in `folder`.

        Raises:
            ConfigError: the station cannot use this calibration, or its file cannot be read or written.
        """
        line = {"calibration": str(folder.absolute())}
        rig = load_station(self._config, self.changes | line).bench()
        if rig.devices is not None:
            plan(rig.registered(rig.devices), rig.robot)
        if self.file is None:
            self._undo, self.changes = self.changes, self.changes | line
        else:
            before = read_text(self.file)
            after = _with_line(before, line)
            if parse_toml(after, str(self.file)) != parse_toml(before, str(self.file)) | line:
                raise ConfigError(f"{self.file}: cannot replace its key; edit the file: {toml_lines(line)[0]}")
            _write(self.file, after)
            self._undo = before, after
        self.restart.set()

    def undo(self) -> None:
        """Choose the calibration before the last `apply` again.

        Raises:
            RefusedError: nothing was applied, or the station's file has changed since.
            ConfigError: the station's file cannot be read or written.
        """
        if self._undo is None:
            raise RefusedError("no calibration was applied since the program has started; nothing to undo")
        if isinstance(self._undo, dict):
            self.changes = self._undo
        elif self.file is not None:
            before, after = self._undo
            if read_text(self.file) != after:
                raise RefusedError(f"{self.file} has changed since; edit its key calibration instead of Undo")
            _write(self.file, before)
        self._undo = None
        self.restart.set()


def _with_line(text: str, table: Mapping[str, str]) -> str:
    """Return a station file's text with the line of `table`; it replaces the old line or follows the first comments."""
    (line,), lines, at = toml_lines(table), text.splitlines(), line_of(text, *table)
    if at is None:
        at = next((number for number, known in enumerate(lines) if not known.startswith("#")), len(lines))
        return "\n".join([*lines[:at], line, *lines[at:]]) + "\n"
    return "\n".join([*lines[: at - 1], line, *lines[at:]]) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        write_atomically(text, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
