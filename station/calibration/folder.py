"""The folder of a calibration: its files, and a new one, made at once, so that nobody else takes its name meanwhile."""

import contextlib
from pathlib import Path

from station.config.strict import ConfigError

#: What was measured, what came of it as numbers, and for reading.
VISITS, NUMBERS, REPORT = "visits.json", "report.json", "report.html"


def new_folder(out: Path, name: str) -> Path:
    """A folder in `out` that was not there before.

    Raises:
        ConfigError: `out` cannot be written to.
    """
    number = 1
    try:
        out.mkdir(parents=True, exist_ok=True)
        while True:
            path = out / (name if number == 1 else f"{name}-{number}")
            with contextlib.suppress(FileExistsError):
                path.mkdir()
                return path
            number += 1
    except OSError as error:
        raise ConfigError(f"{out}: cannot write results there: {error.strerror}") from None
