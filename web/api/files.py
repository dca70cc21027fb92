"""Access to the data folder for web requests: separate threads, and responses that read a file in these threads.

The disk of the data folder may be a network disk that does not answer for minutes. Only these threads then wait for it.
Commands, STOP and the end of the station never wait for a disk.
"""

import asyncio
import contextlib
import hashlib
import os
import re
import threading
from collections.abc import Callable, Mapping
from email.utils import formatdate
from functools import partial
from pathlib import Path
from typing import IO, Any, ParamSpec, TypeVar
from urllib.parse import quote

from starlette.background import BackgroundTask
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from station.regular_file import open_in
from web.api.schemas import ErrorOut

P = ParamSpec("P")
T = TypeVar("T")

#: Largest number of file operations at the same time, and time for which a request waits for one of them [s].
MAX_OPERATIONS, PATIENCE_S = 8, 5.0
#: Number of bytes of a file that one operation reads.
CHUNK_BYTES = 256 * 1024
FILES_BUSY: dict[int | str, dict[str, Any]] = {
    503: {"model": ErrorOut, "description": "the disk of the data folder does not answer"}
}
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


class FileThreads:
    """Bounded number of threads for file operations. The program's end does not wait for them."""

    def __init__(self, most: int = MAX_OPERATIONS, patience: float = PATIENCE_S) -> None:
        """Allow at most `most` operations at the same time; a further one waits at most `patience` [s]."""
        self._most, self._patience = most, patience
        self._free = asyncio.Semaphore(most)

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a function in a thread and return its result, or raise its exception.

        Raises:
            HTTPException: status 503: all threads have been busy for too long, because the disk does not answer.
        """
        try:
            async with asyncio.timeout(self._patience):
                await self._free.acquire()
        except TimeoutError:
            reason = (
                f"{self._most} file operations have not ended for {self._patience:g} s: the disk of the data folder"
                " does not answer; check it, then try again"
            )
            raise HTTPException(503, reason) from None
        return await self._call(partial(function, *args, **kwargs))

    async def run_later(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a function as soon as a thread is free, and return its result, or raise its exception."""
        await self._free.acquire()
        return await self._call(partial(function, *args, **kwargs))

    async def _call(self, function: Callable[[], T]) -> T:
        loop = asyncio.get_running_loop()
        done: asyncio.Future[T] = loop.create_future()

        def finish(set_result: Callable[[Any], None], value: Any) -> None:
            self._free.release()
            if not done.done():  # the request may have been cancelled
                set_result(value)

        def work() -> None:
            try:
                found = partial(finish, done.set_result, function())
            except BaseException as error:
                found = partial(finish, done.set_exception, error)
            with contextlib.suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(found)

        # Daemon threads, because the interpreter waits for all others before it ends.
        threading.Thread(target=work, name="file", daemon=True).start()
        return await done


class StoredFile(Response):
    """Response with a regular file, or with a range of it. `stored_file` creates it."""

    def __init__(
        self, files: FileThreads, file: IO[bytes], media_type: str, name: str, headers: Mapping[str, str],
        background: BackgroundTask | None,
    ) -> None:  # fmt: skip
        self._files, self._file = files, file
        self.status_code, self.media_type, self.background = 200, media_type, background
        status = os.fstat(file.fileno())
        self._size = status.st_size
        tag = hashlib.sha256(f"{status.st_mtime_ns}-{status.st_size}".encode()).hexdigest()[:32]
        self.init_headers({
            "accept-ranges": "bytes", "last-modified": formatdate(status.st_mtime, usegmt=True), "etag": f'"{tag}"',
            **({"content-disposition": _attachment(name)} if name else {}), **headers,
        })  # fmt: skip

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002
        """Send the file; a range that is not valid is ignored, so that the whole file is sent."""
        try:
            start, end = self._range(Headers(scope=scope))
            if start >= end and self._size:
                self.status_code = 416
                self.headers["content-range"] = f"bytes */{self._size}"
                end = start
            elif (start, end) != (0, self._size):
                self.status_code = 206
                self.headers["content-range"] = f"bytes {start}-{end - 1}/{self._size}"
            empty = start == end
            self.headers["content-length"] = str(end - start)
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            gone: Callable[[], bool] = scope.get("state", {}).get("gone", lambda: False)
            while start < end and not gone():
                chunk = await self._files.run_later(os.pread, self._file.fileno(), min(CHUNK_BYTES, end - start), start)
                if not chunk:
                    raise OSError(f"the file has become shorter than {self._size} bytes while it was sent")
                start += len(chunk)
                await send({"type": "http.response.body", "body": chunk, "more_body": start < end})
            if empty:
                await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            # A disk that does not answer would block even the closing of the file.
            threading.Thread(target=self._file.close, name="file", daemon=True).start()
            if self.background is not None:
                await self.background()

    def _range(self, headers: Headers) -> tuple[int, int]:
        """Return start and end of the requested range [bytes]; without a range, those of the whole file."""
        found = _RANGE.fullmatch(headers.get("range", "").replace(" ", "").lower())
        known = self.headers["etag"], self.headers["last-modified"]
        if found is None or not any(found.groups()) or headers.get("if-range", known[0]) not in known:
            return 0, self._size
        first, last = (text[:MAX_DIGITS] for text in found.groups())
        if not first:
            return max(0, self._size - int(last)), self._size
        end = min(self._size, int(last) + 1) if last else self._size
        return (int(first), end) if not last or int(last) >= int(first) else (0, self._size)


#: Number of digits of a range that are used: larger numbers are beyond the end of any file.
MAX_DIGITS = 18


def _attachment(name: str) -> str:
    quoted = quote(name)
    return f'attachment; filename="{name}"' if quoted == name else f"attachment; filename*=utf-8''{quoted}"


async def stored_file(
    files: FileThreads, folder: Path, name: str, media_type: str, *, attachment: str = "",
    headers: Mapping[str, str] | None = None, background: BackgroundTask | None = None,
) -> StoredFile:  # fmt: skip
    """Return the response with a regular file of a folder.

    Args:
        files: threads that read the file.
        folder, name: the folder, which must not be a link, and the name of the file.
        media_type: media type of the response.
        attachment: name under which the client stores the file; empty: the client shows it.
        headers: further headers of the response.
        background: task to carry out after the response.

    Raises:
        HTTPException: status 404: the file does not exist or is no regular file, for example a link; 503: see `run`.
    """
    try:
        file = await files.run(open_in, folder, name)
    except OSError as error:
        raise HTTPException(404, f"file '{name}' of '{folder.name}' cannot be read: {error.strerror}") from None
    return StoredFile(files, file, media_type, attachment, headers or {}, background)
