"""Exclusive access to a device: a lock on a file that is named after the device, kept while its link is open.

The lock is necessary because Unix systems let two programs open one serial port, and because a Net F/T box serves only
the latest client. The operating system releases the lock when the process ends for any reason. On Windows this module
locks nothing, because Windows opens a serial port only once.
"""

import contextlib
import os
import socket
import sys
import tempfile
from pathlib import Path
from urllib.parse import quote, urlsplit

from core.errors import CtrError

if sys.platform != "win32":
    import fcntl


class PortInUse(CtrError):
    """Another station uses the device; the text names the device and the process of that station."""


def device_name(url: str) -> str:
    """Return a unique name of the device: its file with symbolic links resolved, or its URL with the host's address."""
    if "://" not in url:
        return os.path.realpath(url)
    parts = urlsplit(url)
    host = parts.hostname or ""
    try:
        host = str(socket.getaddrinfo(host, parts.port)[0][4][0])
    except (OSError, ValueError):
        return url  # the host is unknown, so the device cannot be opened either, or the URL has no host
    return f"{parts.scheme}://{host}:{parts.port}"


def lock_file(url: str) -> Path:
    """Return the path of the lock file of a device."""
    return Path(tempfile.gettempdir()) / f"ctr-station-{quote(device_name(url), safe='')}.lock"


def clear_left_behind() -> None:
    """Remove lock files that killed stations of this user have left, which are the files without a lock."""
    for path in Path(tempfile.gettempdir()).glob("ctr-station-*.lock"):
        with contextlib.suppress(OSError):  # the file is locked, belongs to another user, or was just removed
            if sys.platform != "win32" and path.lstat().st_uid == os.getuid():
                file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False)):
                        path.unlink()
                finally:
                    os.close(file)


class PortLock:
    """Lock of one device."""

    def __init__(self, url: str) -> None:
        """Lock the device.

        Raises:
            PortInUse: a link of this or another process uses the device, or the lock file cannot be opened.
        """
        self._file: int | None = None
        if sys.platform == "win32":
            return
        self._path = lock_file(url)
        try:
            self._file = _locked(self._path)
        except BlockingIOError as error:
            holder = str(error)
            advice = "end that station, or configure another port"
            if holder == str(os.getpid()):
                advice = "which is this one: two devices cannot have one port"
            raise PortInUse(f"{url} is in use by process {holder or '(not known yet)'}; {advice}") from None
        except OSError as error:
            raise PortInUse(
                f"{url}: its lock file {self._path} cannot be opened: {error.strerror}; remove that file"
            ) from None

    def release(self) -> None:
        """Unlock the device."""
        if self._file is not None and sys.platform != "win32":
            # Remove the file while it is locked, because afterwards another station may lock it. A file of another
            # user cannot be removed and stays.
            with contextlib.suppress(OSError):
                self._path.unlink()
            # Unlock explicitly, because a child process may have inherited the open file and keep the lock.
            fcntl.flock(self._file, fcntl.LOCK_UN)
            os.close(self._file)
            self._file = None


def _locked(path: Path) -> int:
    """Lock the file, write this process's number into it, and return its descriptor.

    Raises:
        BlockingIOError: another link has locked the file; the text is the number of the locking process.
    """
    while True:
        file = _open(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False)):
                os.ftruncate(file, 0)
                os.pwrite(file, str(os.getpid()).encode(), 0)
                return file
            os.close(file)
        except FileNotFoundError:
            os.close(file)  # the previous owner has just removed the file
        except BlockingIOError:
            holder = os.pread(file, 20, 0).decode("ascii", "replace").strip()
            os.close(file)
            raise BlockingIOError(holder) from None


def _open(path: Path) -> int:
    """Open the file so that any user may lock it, because a station of another account may use the same device."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        try:
            return os.open(path, flags)
        except FileNotFoundError:
            pass
        try:
            file = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue  # another process has created it
        os.fchmod(file, 0o666)  # independent of the umask of this process
        return file
