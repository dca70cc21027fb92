"""Creates the folder of a calibration. The folder is created before its files, which reserves its name."""

import contextlib
from pathlib import Path

from station.config.strict import ConfigError

#: File names of the measurements, the numbers and the report.
VISITS_FILE, REPORT_NUMBERS_FILE, REPORT_FILE = "visits.json", "report.json", "report.html"


def new_folder(out: Path, name: str) -> Path:
    """Create a new folder in `out`; a number is appended if the name exists.

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
