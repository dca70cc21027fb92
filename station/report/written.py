"""A file of a report, whole or not at all."""

from pathlib import Path

from core.errors import CtrError


class ReportError(CtrError):
    """A report that cannot be written."""


def written(text: str, path: Path) -> Path:
    """Write a file, whole or not at all.

    Raises:
        OSError: the disk does not take it.
    """
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    return partial.replace(path)
