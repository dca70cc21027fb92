"""What a search has looked at: a line of JSON for each candidate, so that a search that was stopped goes on.

The first line says what the search is. A line is written whole; half a last one (kill -9, a full disk) is dropped and
its candidate looked at again.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from station.config.strict import ConfigError
from station.design.study import Study
from station.recording.kept_lines import KeptLines, whole_lines
from station.recording.metadata import PACKAGES, versions

NAME = "candidates.jsonl"
#: What is kept of a candidate: `parameters` (p,), `cost`, and what makes it up.
Line = Mapping[str, Any]


class Candidates:
    """The file, locked until it is closed."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Begin it, or go on with it.

        Raises:
            ConfigError: another study is kept there.
            RecordingError: somebody else searches there, the file is no list, or the disk does not take it.

        """
        self.path, self.lines = folder / NAME, dict[tuple[float, ...], Line]()
        plan = plan_of(study)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = KeptLines(self.path, "searches there")
        except OSError as error:
            raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
        try:
            self._begin(plan)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let others have it."""
        self._file.close()

    def append(self, line: Line) -> None:
        """Keep a candidate.

        Raises:
            RecordingError: the disk does not take it.

        """
        self._file.append(line)
        self.lines[tuple(line["parameters"])] = line

    def _begin(self, plan: Mapping[str, Any]) -> None:
        kept, self._file.length = whole_lines(self.path, self.path.read_bytes())
        try:
            self.lines = {tuple(line["parameters"]): line for line in kept[1:] if line["cost"] is not None}
        except (KeyError, TypeError):
            raise ConfigError(f"{self.path}: is no list of candidates; repair it, or take another folder") from None
        if not kept:
            self._file.append(plan)
        elif kept[0] != plan:
            names = ", ".join(name for name in plan if kept[0].get(name) != plan[name])
            raise ConfigError(f"{self.path}: another search is kept there ({names} differ); take another folder")


def plan_of(study: Study) -> dict[str, Any]:
    """What makes a search what it is; ready for JSON."""
    found = versions()
    robot = hashlib.sha256(study.robot.model_dump_json().encode()).hexdigest()
    return {
        "study": study.file.model_dump(mode="json"),
        "robot": robot,
        "versions": {name: found[name] for name in PACKAGES},
    }


def of(study: Study, line: Line) -> dict[str, float]:
    """Its parameters by key."""
    return dict(zip([each.key for each in study.file.parameters], line["parameters"], strict=True))


def best(lines: Sequence[Line]) -> Line:
    """The one that costs least; of several the first."""
    return min(lines, key=lambda line: line["cost"])
