"""Stages of a driver of one's own, and who stops them when the control process has died."""

import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.harness.calm import CLOCK
from tests.harness.kill_stations import back
from tests.harness.lone_station import lone_station
from tests.harness.waiting import until
from tests.harness.watched_lab import WatchedLab


class Box:
    """Takes lines of velocities, says where the stages are 100 times a second, and notes what it was told."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.server.getsockname()[1])
        self.told: list[bytes] = []
        self._over = threading.Event()
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        self.server.settimeout(0.1)
        while not self._over.is_set():
            try:
                host = self.server.accept()[0]
            except TimeoutError:
                continue
            self._threads.append(threading.Thread(target=self._serve, args=(host,)))
            self._threads[-1].start()

    def _serve(self, host: socket.socket) -> None:
        heard = b""
        with host:
            host.settimeout(0.01)
            while not self._over.is_set():
                try:
                    host.sendall(b"0.0 1.5707963 -0.1\n")
                    if not (more := host.recv(4096)):
                        return
                except TimeoutError:
                    continue
                except OSError:
                    return
                *lines, heard = (heard + more).split(b"\n")
                self.told += lines
                if b"stop" in lines:
                    host.sendall(b"stopped\n")

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        self.server.close()


@pytest.fixture
def box() -> Iterator[Box]:
    box = Box()
    yield box
    box.close()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch) -> Path:
    """A distribution with the driver."""
    folder = tmp_path / "site" / "my_bench-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: my-bench\nVersion: 1.0\n", encoding="utf-8")
    entry = "faulty-stages = tests.harness.faulty_stages:open_stages"
    (folder / "entry_points.txt").write_text(f"[ctr_station.devices]\n{entry}\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]))
    return tmp_path


def test_the_station_process_stops_them_by_their_own_emergency_stop(box: Box, installed: Path) -> None:
    stages = {"driver": "faulty-stages", "host": "127.0.0.1", "port": box.port}
    with WatchedLab(CLOCK) as lab, lone_station(installed / "runs", lab, stages=stages) as station:

        def fault() -> str:
            """Its cause, once the stages have been stopped; what the box was told is forgotten."""
            status = until(lambda: "reset to start it anew" in (now := station.ask("status"))["cause"] and now)
            assert f"3 stages at socket://127.0.0.1:{box.port} say that they have stopped" in status["cause"]
            assert b"stop" in box.told
            box.told.clear()
            return status["cause"]

        station.child("control").kill()
        assert fault().startswith("the control process ended by signal 9")
        back(station)
        assert station.ask("home")["refused"] == ""
        assert fault().startswith("driver 'faulty-stages' of devices.stages: poll raised ZeroDivisionError: float div")
