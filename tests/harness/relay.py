"""Relay between browser and station that can cut the connections of the scene alone."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Relay:
    """Relay that listens on a separate port and passes every connection on to the station's port."""

    def __init__(self, station: int) -> None:
        self._station = station
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.scenes = 0  #: number of the scene's WebSockets that were passed on
        self._whole = True
        self._lock = threading.Lock()
        self._ends: dict[socket.socket, bool] = {}  # open sockets, and whether each belongs to the scene
        self._threads = [threading.Thread(target=self._accept, name="relay")]
        self._threads[0].start()

    def cut(self) -> None:
        """Close the scene's WebSockets, and refuse new ones."""
        self._whole = False
        with self._lock:
            for end in [end for end, of_scene in self._ends.items() if of_scene]:
                _shut(end)

    def mend(self) -> None:
        """Accept the scene's WebSockets again."""
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
            of_scene = first.startswith(b"GET /viser/") and b"upgrade: websocket" in first.lower()
            if of_scene and not self._whole:
                return
            self.scenes += of_scene
            with self._lock:
                self._ends |= {browser: of_scene, station: of_scene}
            station.sendall(first)
            back = threading.Thread(target=_pass_on, args=(station, browser), name="relay")
            back.start()
            _pass_on(browser, station)
            back.join()
            with self._lock:
                del self._ends[browser], self._ends[station]


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
    _shut(source)
    _shut(sink)


def _shut(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


@contextmanager
def relayed(station: int) -> Iterator[Relay]:
    relay = Relay(station)
    try:
        yield relay
    finally:
        relay.close()
