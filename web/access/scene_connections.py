"""Access limits of viser's port, because viser itself accepts every client, although only the proxy needs access.

The port listens on loopback, where other programs and every page in a browser of this computer can connect. Therefore
pages are refused, and a connection beyond the limit closes the oldest connection without a request, or else the oldest
of all. Without a limit, connections could use up the file descriptors that STOP needs.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

from websockets.asyncio import server
from websockets.asyncio.server import ServerConnection


@contextmanager
def limited_scene_server(most: int) -> Iterator[None]:
    """Provide a context in which a new viser server accepts at most `most` connections, and no connection from a page.

    viser has no settings for these limits, so the context changes the `websockets` server that viser uses.
    """
    plain, open_ = server.serve, list[_Guarded]()
    changed = cast("Any", server)
    # `origins=[None]` refuses browsers, which send an Origin header; the proxy sends none.
    guarded = cast("Any", partial(_Guarded, open_, most))
    changed.serve = partial(plain, origins=[None], create_connection=guarded)
    try:
        yield
    finally:
        changed.serve = plain


class _Guarded(ServerConnection):
    """Connection to viser that counts toward the limit."""

    def __init__(self, open_: "list[_Guarded]", most: int, *args: Any, **options: Any) -> None:
        """`open_` lists the open connections, oldest first; `most` is the largest number of open connections."""
        super().__init__(*args, **options)
        self._open, self._most = open_, most

    def connection_made(self, transport: Any) -> None:
        """Add this connection; at the limit, close first the oldest without a request, or else the oldest of all."""
        super().connection_made(transport)
        if len(self._open) >= self._most:
            victim = min(self._open, key=lambda known: known.request is not None)
            self._open.remove(victim)
            victim.transport.abort()
        self._open.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the list."""
        if self in self._open:
            self._open.remove(self)
        super().connection_lost(exc)
