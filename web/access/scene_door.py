"""The door of viser's own port: it is for the proxy of this process, and viser itself lets everybody in.

It listens on loopback, where other programs of this computer knock, and every page in its browsers. So a page is
refused, and connections are bounded: one too many costs the longest silent its place. Their descriptors are those
with which STOP is answered.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

from websockets.asyncio import server
from websockets.asyncio.server import ServerConnection


@contextmanager
def guarded_scene(most: int) -> Iterator[None]:
    """A viser server that is made within has at most so many connections, and none of a page's own.

    viser has no words for either; its server is that of websockets, which has.
    """
    plain, open_ = server.serve, list[_Guarded]()
    changed = cast("Any", server)
    # Browsers say where a page comes from, the proxy does not.
    guarded = cast("Any", partial(_Guarded, open_, most))
    changed.serve = partial(plain, origins=[None], create_connection=guarded)
    try:
        yield
    finally:
        changed.serve = plain


class _Guarded(ServerConnection):
    """A connection that is counted."""

    def __init__(self, open_: "list[_Guarded]", most: int, *given: Any, **told: Any) -> None:
        """`open_` are those that are open, the oldest first."""
        super().__init__(*given, **told)
        self._open, self._most = open_, most

    def connection_made(self, transport: Any) -> None:
        """If it is one too many another one goes: one that has asked for nothing, the oldest before the others."""
        super().connection_made(transport)
        if len(self._open) >= self._most:
            last = min(self._open, key=lambda known: known.request is not None)
            self._open.remove(last)
            last.transport.abort()
        self._open.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Its place is free."""
        if self in self._open:
            self._open.remove(self)
        super().connection_lost(exc)
