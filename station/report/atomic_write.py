"""Write a report's file atomically: a reader never sees an incomplete file."""

from pathlib import Path

from core.errors import CtrError


class ReportError(CtrError):
    """A report cannot be written."""


def write_atomically(text: str, path: Path) -> Path:
    """Replace a file by a text atomically: readers see the old file or the complete new one.

    Raises:
        OSError: the file cannot be written, for example because the disk is full.
    """
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    return partial.replace(path)
