"""Start `ctr-station serve` in a separate process, and a browser that shows the page of this station."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from core.errors import CtrError
from station.client import Station
from station.config.robots import RobotFile
from station.config.strict import toml_lines
from station.control.process import ring_width
from station.control.ring import SEGMENT_FOLDER, SEGMENT_PREFIX, Ring

#: Longest time for the start of a station, which compiles on a new installation, and for its shutdown [s].
START_TIMEOUT_S = 300.0
#: Waiting time after the start of the browser, in which the browser draws its first frames [s].
BROWSER_WARMUP_S = 10.0
#: Program names under which a Chromium browser may be installed.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--window-size=1280,720",
)  # fmt: skip


class ServedStation:
    """Station that runs in a separate process."""

    def __init__(self, url: str, pid: int, address_s: float, ready_s: float) -> None:
        self.url, self.pid = url, pid
        self.address_s = address_s  #: time from the start of the process until it printed its address [s]
        self.ready_s = ready_s  #: time from the start of the process until it was READY [s]

    @contextmanager
    def ring(self, robot: RobotFile) -> Iterator[Ring]:
        """Open the telemetry ring of the station; `robot` is the station's robot.

        Raises:
            CtrError: the operating system does not list shared memory by name, so the ring was not found.
        """
        names = [path.name for path in SEGMENT_FOLDER.glob(f"{SEGMENT_PREFIX}{self.pid}_*")]
        if len(names) != 1:
            raise CtrError(f"no telemetry of a station in {SEGMENT_FOLDER}: this needs Linux")
        ring = Ring(ring_width(robot), names[0])
        # The station removes the shared memory. Without this call, Python would also do so at the end of this process.
        resource_tracker.unregister(f"/{names[0]}", "shared_memory")
        try:
            yield ring
        finally:
            ring.close(remove=False)


@contextmanager
def serve_station(folder: Path, settings: Mapping[str, Any]) -> Iterator[ServedStation]:
    """Start a station with `settings` as its station file and data in `folder`; yield the station when it is READY.

    Raises:
        CtrError: the station does not start; the message has its output.
    """
    config, output = folder / "station.toml", folder / "output.txt"
    config.write_text("\n".join(toml_lines(settings)) + "\n", encoding="utf-8")
    # `web` is imported in the child process only: the package `station` must not import `web`, a higher layer.
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", "0"]
    started = time.monotonic()
    with output.open("w", encoding="utf-8") as out:
        process = subprocess.Popen(  # noqa: S603 - this program itself
            [*command, "--config", str(config), "--data", str(folder)], stdout=out, stderr=subprocess.STDOUT
        )
    try:
        url = _address(process, output)
        address_s = time.monotonic() - started
        with Station(url) as script:
            script.wait_for("READY", START_TIMEOUT_S)
        yield ServedStation(url, process.pid, address_s, time.monotonic() - started)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(START_TIMEOUT_S)


def browser() -> str | None:
    """Return the path of a Chromium browser on this computer; None if there is none."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def open_page(station: ServedStation, browser: str, folder: Path) -> Iterator[None]:
    """Show the page of the station in a browser without a window (headless)."""
    command = [browser, *BROWSER_FLAGS, f"--user-data-dir={folder}", station.url]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:  # noqa: S603
        try:
            time.sleep(BROWSER_WARMUP_S)
            if process.poll() is not None:
                raise CtrError(f"{browser} has ended with status {process.returncode}")
            yield
        finally:
            process.terminate()


def _address(process: "subprocess.Popen[bytes]", output: Path) -> str:
    started = time.monotonic()
    while "is at http" not in (text := output.read_text(encoding="utf-8")):
        if process.poll() is not None or time.monotonic() - started > START_TIMEOUT_S:
            raise CtrError(f"the station did not start: {text.strip()}")
        time.sleep(0.05)
    return text.split("is at ")[1].split()[0]
