"""A station started by `ctr-station serve` in a separate process, and a browser that shows its page."""

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
from station.config.toml_text import toml_lines
from station.control.process import ring_width
from station.control.ring import SEGMENT_FOLDER, SEGMENT_PREFIX, Ring

#: Limit of the first start of a new installation, which compiles, and of the shutdown [s].
START_TIMEOUT_S = 300.0
#: Time until a browser has started and drawn its first frames [s].
BROWSER_WARMUP_S = 10.0
#: Possible names of the browser.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--window-size=1280,720",
)  # fmt: skip


class ServedStation:
    """A running station."""

    def __init__(self, url: str, pid: int) -> None:
        self.url, self._pid = url, pid

    @contextmanager
    def ring(self, robot: RobotFile) -> Iterator[Ring]:
        """Open the station's telemetry.

        Raises:
            CtrError: this system does not list shared memory by name.
        """
        names = [path.name for path in SEGMENT_FOLDER.glob(f"{SEGMENT_PREFIX}{self._pid}_*")]
        if len(names) != 1:
            raise CtrError(f"no telemetry of a station in {SEGMENT_FOLDER}: this needs Linux")
        ring = Ring(ring_width(robot), names[0])
        # The station removes it: without this, Python would remove it at the end of this process.
        resource_tracker.unregister(f"/{names[0]}", "shared_memory")
        try:
            yield ring
        finally:
            ring.close(remove=False)


@contextmanager
def serve_station(folder: Path, settings: Mapping[str, Any]) -> Iterator[ServedStation]:
    """Start a station with these keys of its file and its data in `folder`; yield it when it is READY.

    Raises:
        CtrError: it does not start; the text is its output.
    """
    config, output = folder / "station.toml", folder / "output.txt"
    config.write_text("\n".join(toml_lines(settings)) + "\n", encoding="utf-8")
    # As text: this package must not import `web`, which is above it.
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", "0"]
    with output.open("w", encoding="utf-8") as out:
        process = subprocess.Popen(  # noqa: S603 - ourselves
            [*command, "--config", str(config), "--data", str(folder)], stdout=out, stderr=subprocess.STDOUT
        )
    try:
        url = _address(process, output)
        with Station(url) as script:
            script.wait_for("READY", START_TIMEOUT_S)
        yield ServedStation(url, process.pid)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(START_TIMEOUT_S)


def browser() -> str | None:
    """Return the path of this computer's browser, or None."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def open_page(station: ServedStation, browser: str, folder: Path) -> Iterator[None]:
    """Show the station's page in a browser without a window."""
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
