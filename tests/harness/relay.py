"""Relay between browser and station that can cut all connections, or those of the scene alone."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Whether a connection that begins with these bytes is one of those that the relay can cut.
Concerns = Callable[[bytes], bool]


def of_scene(first: bytes) -> bool:
    return first.startswith(b"GET /viser/") and b"upgrade: websocket" in first.lower()


def of_all(_: bytes) -> bool:
    return True


class Relay:
    """Relay that listens on a separate port and passes every connection on to the station's port."""

    def __init__(self, station: int, concerns: Concerns) -> None:
        self._station, self._concerns = station, concerns
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.passed = 0  #: number of the connections of concern that were passed on
        #: A text of the browser's requests, and the text with which the relay replaces it, as a proxy does.
        self.replaced = (b"", b"")
        self._whole = True
        self._lock = threading.Lock()
        self._ends: dict[socket.socket, bool] = {}  # open sockets, and whether each is of concern
        self._threads = [threading.Thread(target=self._accept, name="relay")]
        self._threads[0].start()

    def cut(self) -> None:
        """Close the connections of concern, and refuse new ones."""
        with self._lock:
            self._whole = False
            for end in [end for end, concerns in self._ends.items() if concerns]:
                _shut(end)

    def mend(self) -> None:
        """Accept the connections of concern again."""
        self._whole = True

    def close(self) -> None:
        _shut(self._server)
        self._server.close()
        with self._lock:
            for end in self._ends:
                _shut(end)
        # The threads end because the browser is closed, and with it the connections that it never used.
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                browser = self._server.accept()[0]
            except OSError:
                return
            thread = threading.Thread(target=self._serve, args=(browser,), name="relay")
            self._threads.append(thread)
            thread.start()

    def _serve(self, browser: socket.socket) -> None:
        with browser, socket.create_connection(("127.0.0.1", self._station)) as station, contextlib.suppress(OSError):
            first = browser.recv(65536)
            concerns = self._concerns(first)
            with self._lock:
                if concerns and not self._whole:
                    return
                self.passed += concerns
                self._ends |= {browser: concerns, station: concerns}
            station.sendall(self._changed(first))
            back = threading.Thread(target=_pass_on, args=(station, browser), name="relay")
            back.start()
            _pass_on(browser, station, self._changed)
            back.join()
            with self._lock:
                del self._ends[browser], self._ends[station]

    def _changed(self, data: bytes) -> bytes:
        return data.replace(*self.replaced) if self.replaced[0] else data


def _pass_on(source: socket.socket, sink: socket.socket, changed: Callable[[bytes], bytes] = lambda data: data) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(changed(data))
    _shut(source)
    _shut(sink)


def _shut(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


@contextmanager
def relayed(station: int, concerns: Concerns) -> Iterator[Relay]:
    relay = Relay(station, concerns)
    try:
        yield relay
    finally:
        relay.close()
