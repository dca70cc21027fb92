"""Opening of files in the data folder: only regular files are opened, and no link is followed.

A FIFO, a device or a socket in place of a file is refused without waiting for it, and so is a link, because it may
point to any file of the computer.
"""

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import IO

#: Kinds of files that are not regular files, for error messages.
_KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotRegularError(OSError):
    """A path is not a regular file, or its folder is a link."""


def open_regular(name: Path | str, folder: int | None = None) -> IO[bytes]:
    """Open a regular file for reading; the last part of its path must not be a link.

    Args:
        name: path of the file.
        folder: descriptor of the folder to which the path is relative; None: the current folder.

    Raises:
        NotRegularError: the path is a link, a folder, a FIFO, a socket or a device.
        OSError: the file does not exist or cannot be opened.
    """
    # The kind is checked before the file is opened, because opening some devices changes them.
    _check_regular(os.stat(name, dir_fd=folder, follow_symlinks=False), name)
    descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    try:
        # The path may have been replaced since the first check.
        _check_regular(os.fstat(descriptor), name)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def open_to_append(path: Path) -> FileIO:
    """Open a regular file for appending without a buffer; create it if necessary.

    Raises:
        NotRegularError: the path is a link, a folder, a FIFO, a socket or a device.
        OSError: the file cannot be written.
    """
    with contextlib.suppress(FileNotFoundError):
        _check_regular(path.lstat(), path)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(path, flags, 0o666)
    try:
        _check_regular(os.fstat(descriptor), path)
        return FileIO(descriptor, "a")
    except BaseException:
        os.close(descriptor)
        raise


@contextmanager
def open_folder(name: Path | str, folder: int | None = None) -> Iterator[int]:
    """Provide the descriptor of a folder; the last part of its path must not be a link. Arguments as `open_regular`.

    Raises:
        NotRegularError: the path is a link or a file.
        OSError: the folder does not exist or cannot be opened.
    """
    try:
        descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY, dir_fd=folder)
    except NotADirectoryError:
        raise NotRegularError(errno.ENOTDIR, f"'{Path(name).name}' is a link or a file, not a folder", name) from None
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def open_in(folder: Path, name: str) -> IO[bytes]:
    """Open a regular file of a run's folder, of which neither the folder nor the file is a link.

    Raises:
        NotRegularError: the file or the folder is something else, for example a link.
        OSError: the file does not exist or cannot be opened.
    """
    if name in ("", ".", "..") or "/" in name:
        raise NotRegularError(errno.EINVAL, f"'{name}' is not the name of a file in the folder", name)
    with open_folder(folder) as inside:
        return open_regular(name, inside)


def read_in(folder: Path, name: str) -> bytes:
    """Return the content of a regular file of a folder; exceptions as `open_in`."""
    with open_in(folder, name) as file:
        return file.read()


def is_regular(path: Path) -> bool:
    """Return whether a path is a regular file, and not a link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):  # ValueError: the name has a zero character
        return False


def is_hidden(path: Path) -> bool:
    """Return whether a file or folder is hidden, as those that systems and editors write next to a user's files."""
    return path.name.startswith(".")


def _check_regular(status: os.stat_result, name: Path | str) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise NotRegularError(errno.EINVAL, f"'{Path(name).name}' is {kind}, not a regular file", name)
