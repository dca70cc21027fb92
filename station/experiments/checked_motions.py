"""Results of the check of this package's motions on the model, stored in the user's cache.

The check of all experiments takes several seconds of processor time. The file is valid as long as this package and the
libraries that the model uses are unchanged. An unreadable or unwritable file only costs the time of another check.
"""

import contextlib
import hashlib
import os
from functools import cache
from importlib.metadata import version
from pathlib import Path

from pydantic import ValidationError

import core
import station
from station.config.strict import Strict
from station.recording.run_folder import write_atomically

#: Warnings about the load of each checked motion, by the digest of its description.
Warnings = dict[str, tuple[str, ...]]


def _file() -> Path | None:
    try:
        folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # a user without a home folder, for example in a container
        return None
    return Path(folder, "ctr-station", "checked-motions.json")


#: File of the checked motions; None: there is none.
FILE = _file()


class _Saved(Strict):
    fingerprint: str
    """digest of this package and the libraries that the model uses"""
    motions: Warnings


def digest(description: str) -> str:
    """Return the key of a motion with this complete description."""
    return hashlib.sha256(description.encode()).hexdigest()[:32]


def read() -> Warnings:
    """Return the motions that have passed the check, with the warnings about their loads."""
    if FILE is None:
        return {}
    try:
        saved = _Saved.model_validate_json(FILE.read_bytes())
    except (OSError, ValidationError):
        return {}
    return saved.motions if saved.fingerprint == _fingerprint() else {}


def write(checked: Warnings) -> None:
    """Add checked motions to the file; another process may have added other motions since `read`."""
    if FILE is None:
        return
    with contextlib.suppress(OSError):
        FILE.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(_Saved(fingerprint=_fingerprint(), motions=read() | checked).model_dump_json(), FILE)


@cache
def _fingerprint() -> str:
    """Return a digest of the size and the time of each file of this package, and of the libraries' versions."""
    found = [version(library) for library in ("numpy", "scipy", "numba")]
    for root in (*core.__path__, *station.__path__):
        for folder, _, names in os.walk(root):
            if Path(folder).name == "__pycache__":
                continue  # compiled code, to which a run may add
            files = [Path(folder, name) for name in names]
            found += [f"{file} {(state := file.stat()).st_size} {state.st_mtime_ns}" for file in files]
    return digest("\n".join(sorted(found)))
