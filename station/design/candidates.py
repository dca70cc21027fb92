"""Stored candidates of a design search: one JSON line for each evaluated robot, so that a stopped search can continue.

The first line of the file identifies the search. A kill or a full disk may leave an incomplete last line; the next
search drops this line and evaluates its candidate again.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from station.config.strict import ConfigError
from station.design.study import Study
from station.recording.line_store import KeptLines, complete_lines
from station.recording.metadata import PACKAGES, versions

CANDIDATES_FILE = "candidates.jsonl"
#: Line of a candidate: its `parameters` (p,), its `cost`, and the numbers from which the cost was computed.
Line = Mapping[str, Any]


class Candidates:
    """File with the candidates of one search, locked until it is closed."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Create the file, or continue an existing one.

        Raises:
            ConfigError: the folder has another study.
            RecordingError: another process uses the folder, the file is invalid, or the disk is full.

        """
        self.path, self.lines = folder / CANDIDATES_FILE, dict[tuple[float, ...], Line]()
        plan = plan_of(study)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = KeptLines(self.path, "searches in this folder")
        except OSError as error:
            raise ConfigError(f"{folder}: cannot write results: {error.strerror}") from None
        try:
            self._read(plan)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close and unlock the file."""
        self._file.close()

    def append(self, line: Line) -> None:
        """Store an evaluated candidate as a line of the file.

        Raises:
            RecordingError: the line cannot be written.

        """
        self._file.append(line)
        self.lines[tuple(line["parameters"])] = line

    def _read(self, plan: Mapping[str, Any]) -> None:
        kept, self._file.length = complete_lines(self.path, self.path.read_bytes())
        try:
            self.lines = {tuple(line["parameters"]): line for line in kept[1:] if line["cost"] is not None}
        except (KeyError, TypeError):
            raise ConfigError(f"{self.path}: not a list of candidates; repair it, or choose another folder") from None
        if not kept:
            self._file.append(plan)
        elif kept[0] != plan:
            names = ", ".join(name for name in plan if kept[0].get(name) != plan[name])
            raise ConfigError(f"{self.path}: the folder has another search ({names} differ); choose another folder")


def plan_of(study: Study) -> dict[str, Any]:
    """Return everything that identifies a search, ready for JSON."""
    found = versions()
    robot = hashlib.sha256(study.robot.model_dump_json().encode()).hexdigest()
    return {
        "study": study.file.model_dump(mode="json"),
        "robot": robot,
        "versions": {name: found[name] for name in PACKAGES},
    }


def parameters_of(study: Study, line: Line) -> dict[str, float]:
    """Return the parameters of a candidate by key of the robot's file."""
    return dict(zip([each.key for each in study.file.parameters], line["parameters"], strict=True))


def best(lines: Sequence[Line]) -> Line:
    """Return the candidate with the smallest cost; if several have it, the first of them."""
    return min(lines, key=lambda line: line["cost"])
