"""Stages of a custom driver, and their stop after the control process has died."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.harness.calm import CLOCK
from tests.harness.leftovers import nothing_left_behind
from tests.harness.lone_station import LoneStation, lone_station
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


class Rig(NamedTuple):
    """A station on stages of a custom driver, their box, and the file that sets how their emergency stop fails."""

    station: LoneStation
    box: Box
    manner: Path


@pytest.fixture(autouse=True, scope="module")
def nothing_is_left_behind() -> Iterator[None]:
    """Check that nothing outlives the module: each new control process connects to the box, which starts a thread."""
    with nothing_left_behind(30.0):
        yield


@pytest.fixture(scope="module")
def rig(nothing_is_left_behind: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """Install a distribution with the driver, and start a station on its stages."""
    place = tmp_path_factory.mktemp("own")
    folder, manner, box = place / "site" / "my_bench-1.0.dist-info", place / "manner", Box()
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: my-bench\nVersion: 1.0\n", encoding="utf-8")
    entry = "[ctr_station.devices]\nbad-stops = tests.harness.bad_stops:open_stages\n"
    (folder / "entry_points.txt").write_text(entry, encoding="utf-8")
    manner.write_text("works", encoding="utf-8")
    stages = {"driver": "bad-stops", "host": "127.0.0.1", "port": box.port, "manner": str(manner)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(place / "site"), os.environ.get("PYTHONPATH", "")]))
        try:
            with WatchedLab(CLOCK) as lab, lone_station(place / "runs", lab, stages=stages) as station:
                yield Rig(station, box, manner)
        finally:
            box.close()


def test_station_process_stops_custom_stages_by_their_emergency_stop(rig: Rig) -> None:
    station, box = rig.station, rig.box

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
    assert fault().startswith("driver 'bad-stops' of devices.stages: poll raised ZeroDivisionError: float div")


def test_emergency_stop_that_ends_the_interpreter_or_hangs_is_reported_and_survived(rig: Rig) -> None:
    texts = {
        "raises SystemExit": "SystemExit of driver 'bad-stops'",
        "raises KeyboardInterrupt": "KeyboardInterrupt of driver 'bad-stops'",
        "hangs": "has not stopped the stages; its attempt is still running after ",
    }
    station = rig.station
    for what, text in texts.items():
        back(station)
        rig.manner.write_text(what, encoding="utf-8")
        assert station.ask("start")["refused"] == ""
        station.child("control").kill()
        status = until(lambda: (now := station.ask("status"))["state"] == "FAULT" and now)
        assert status["cause"].startswith("the control process ended by signal 9; ")
        assert text in station.ask("stop")["note"]
        until(lambda text=text: text in station.ask("status")["cause"])


def test_control_process_without_a_station_ends_although_the_emergency_stop_hangs(rig: Rig) -> None:
    """This test is the last one of its station, which it kills."""
    rig.manner.write_text("works", encoding="utf-8")
    back(rig.station)
    rig.manner.write_text("hangs", encoding="utf-8")
    control = rig.station.child("control")
    os.kill(rig.station.process.pid, signal.SIGKILL)
    control.wait(NET)
