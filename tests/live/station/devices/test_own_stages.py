"""Stages of a custom driver, and their stop after the control process has died."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.harness.calm import CLOCK
from tests.harness.lone_station import lone_station
from tests.harness.waiting import NET, until
from tests.harness.watched_lab import WatchedLab
from tests.tools.kill_stations import back


class Box:
    """Receives lines of velocities, sends positions 100 times per second, and records the received lines."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.server.getsockname()[1])
        self.lines: list[bytes] = []
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
        received = b""
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
                *lines, received = (received + more).split(b"\n")
                self.lines += lines
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
    """Install a distribution with the drivers."""
    folder = tmp_path / "site" / "my_bench-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: my-bench\nVersion: 1.0\n", encoding="utf-8")
    drivers = ("faulty_stages", "bad_stops")
    entries = "\n".join(f"{name.replace('_', '-')} = tests.harness.{name}:open_stages" for name in drivers)
    (folder / "entry_points.txt").write_text(f"[ctr_station.devices]\n{entries}\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]))
    return tmp_path


def test_station_process_stops_custom_stages_by_their_emergency_stop(box: Box, installed: Path) -> None:
    stages = {"driver": "faulty-stages", "host": "127.0.0.1", "port": box.port}
    with WatchedLab(CLOCK) as lab, lone_station(installed / "runs", lab, stages=stages) as station:

        def fault() -> str:
            """Return the cause after the stages have been stopped, and clear the lines that the box received."""
            status = until(lambda: "have stopped" in (now := station.ask("status"))["cause"] and now)
            assert f"3 stages at socket://127.0.0.1:{box.port} report that they have stopped" in status["cause"]
            assert b"stop" in box.lines
            box.lines.clear()
            return status["cause"]

        station.child("control").kill()
        assert fault().startswith("the control process ended by signal 9")
        back(station)
        assert station.ask("home")["refused"] == ""
        assert fault().startswith("driver 'faulty-stages' of devices.stages: poll raised ZeroDivisionError: float div")


def test_every_kind_of_failing_emergency_stop_is_reported_and_survived(box: Box, installed: Path) -> None:
    manner = installed / "manner"
    manner.write_text("", encoding="utf-8")
    stages = {"driver": "bad-stops", "host": "127.0.0.1", "port": box.port, "manner": str(manner)}
    texts = {
        "hangs": "has not stopped the stages; its attempt is still running after ",
        "raises SystemExit": "SystemExit of driver 'bad-stops'",
        "raises KeyboardInterrupt": "KeyboardInterrupt of driver 'bad-stops'",
        "returns None": "NoneType instead of a text, no evidence that the stages stop: press the emergency stop",
        "lies": "driver 'bad-stops' reports: all stages have stopped",
    }
    with WatchedLab(CLOCK) as lab, lone_station(installed / "runs", lab, stages=stages) as station:
        for what in ("returns None", "raises SystemExit", "raises KeyboardInterrupt", "lies", "hangs"):
            manner.write_text(what, encoding="utf-8")
            assert station.ask("start")["refused"] == ""
            station.child("control").kill()
            status = until(lambda: (now := station.ask("status"))["state"] == "FAULT" and now)
            assert status["cause"].startswith("the control process ended by signal 9; ")
            assert texts[what] in station.ask("stop")["note"]
            until(lambda text=texts[what]: text in station.ask("status")["cause"])
            if what != "hangs":
                back(station)


def test_control_process_without_a_station_ends_although_the_emergency_stop_hangs(box: Box, installed: Path) -> None:
    stages = {"driver": "bad-stops", "host": "127.0.0.1", "port": box.port, "manner": "hangs"}
    with WatchedLab(CLOCK) as lab, lone_station(installed / "runs", lab, stages=stages) as station:
        control = station.child("control")
        os.kill(station.process.pid, signal.SIGKILL)
        control.wait(NET)
