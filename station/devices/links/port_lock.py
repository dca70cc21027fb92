"""One device, one station: a lock on a file that is named after the device, held as long as its link is open.

An operating system lets two programs open one serial port, and a Net F/T box serves whoever asked last. The
lock goes with the process that holds it, however that ends. On Windows, which opens a serial port only once,
nothing is locked.
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


class PortTaken(CtrError):
    """A device that another station has; names the device and that station's process."""


def device_name(url: str) -> str:
    """What a device is called whichever way its port was named: the file behind a link, the address of a host."""
    if "://" not in url:
        return os.path.realpath(url)
    parts = urlsplit(url)
    host = parts.hostname or ""
    try:
        host = str(socket.getaddrinfo(host, parts.port)[0][4][0])
    except (OSError, ValueError):
        return url  # it cannot be opened either, or has no host
    return f"{parts.scheme}://{host}:{parts.port}"


def lock_file(url: str) -> Path:
    """The file that is locked for a device."""
    return Path(tempfile.gettempdir()) / f"ctr-station-{quote(device_name(url), safe='')}.lock"


def clear_left_behind() -> None:
    """Remove the files of this user's stations that were killed: those that nobody locks."""
    for path in Path(tempfile.gettempdir()).glob("ctr-station-*.lock"):
        with contextlib.suppress(OSError):  # locked, another user's, or just gone
            if sys.platform != "win32" and path.lstat().st_uid == os.getuid():
                file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False)):
                        path.unlink()
                finally:
                    os.close(file)


class PortLock:
    """The right to use one device."""

    def __init__(self, url: str) -> None:
        """Take it.

        Raises:
            PortTaken: another link has it, in this process or another, or the lock's file cannot be had.
        """
        self._file: int | None = None
        if sys.platform == "win32":
            return
        self._path = lock_file(url)
        try:
            self._file = _locked(self._path)
        except BlockingIOError as error:
            holder = str(error)
            advice = "end that station, or give another port"
            if holder == str(os.getpid()):
                advice = "which is this one: two devices cannot have one port"
            raise PortTaken(f"{url} is in use by process {holder or '(not known yet)'}; {advice}") from None
        except OSError as error:
            raise PortTaken(f"{url}: its lock {self._path} cannot be had: {error.strerror}; remove that file") from None

    def release(self) -> None:
        """Let others have it."""
        if self._file is not None and sys.platform != "win32":
            # The file goes while it is locked, or it would be another's; it stays if that other is another user.
            with contextlib.suppress(OSError):
                self._path.unlink()
            # Unlocked and not only closed: a child process may still have the file from before.
            fcntl.flock(self._file, fcntl.LOCK_UN)
            os.close(self._file)
            self._file = None


def _locked(path: Path) -> int:
    """The file, locked and with our number in it; BlockingIOError, with the other's number, if it is locked."""
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
            os.close(file)  # who had it before has just let go of it
        except BlockingIOError:
            holder = os.pread(file, 20, 0).decode("ascii", "replace").strip()
            os.close(file)
            raise BlockingIOError(holder) from None


def _open(path: Path) -> int:
    """The file, which any user may lock: another account's station counts too."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        try:
            return os.open(path, flags)
        except FileNotFoundError:
            pass
        try:
            file = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue  # somebody was faster
        os.fchmod(file, 0o666)  # whatever the mask of this process
        return file
