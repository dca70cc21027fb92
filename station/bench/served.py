"""A station as a person starts it, `ctr-station serve`, in a process of its own, and a browser that shows its page."""

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
from station.control.ring import PREFIX, SEGMENTS, Ring

#: The first start of a new installation compiles for so long [s]; the end of one that is asked to end takes as long.
PATIENCE = 300.0
#: A browser has started and drawn its first pictures by then [s].
DRAWN = 10.0
#: What the browser may be called.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--window-size=1280,720",
)  # fmt: skip


class Served:
    """A station that runs."""

    def __init__(self, url: str, pid: int) -> None:
        self.url, self._pid = url, pid

    @contextmanager
    def ring(self, robot: RobotFile) -> Iterator[Ring]:
        """Its telemetry.

        Raises:
            CtrError: shared memory cannot be found by its name here.
        """
        names = [path.name for path in SEGMENTS.glob(f"{PREFIX}{self._pid}_*")]
        if len(names) != 1:
            raise CtrError(f"the telemetry of a station is not to be found in {SEGMENTS}: this needs Linux")
        ring = Ring(ring_width(robot), names[0])
        # It is the station's to remove: at our end Python would take it for left behind.
        resource_tracker.unregister(f"/{names[0]}", "shared_memory")
        try:
            yield ring
        finally:
            ring.close(remove=False)


@contextmanager
def served(folder: Path, settings: Mapping[str, Any]) -> Iterator[Served]:
    """A station that is READY, with these keys of its file, its data in `folder`.

    Raises:
        CtrError: it does not start; the text is what it said.
    """
    config, said = folder / "station.toml", folder / "said.txt"
    config.write_text("\n".join(toml_lines(settings)) + "\n", encoding="utf-8")
    # As a text: this room is below the one that serves.
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--no-browser", "--port", "0"]
    with said.open("w", encoding="utf-8") as out:
        process = subprocess.Popen(  # noqa: S603 - ourselves
            [*command, "--config", str(config), "--data", str(folder)], stdout=out, stderr=subprocess.STDOUT
        )
    try:
        url = _address(process, said)
        with Station(url) as script:
            script.wait_for("READY", PATIENCE)
        yield Served(url, process.pid)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)


def browser() -> str | None:
    """The one of this computer."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


@contextmanager
def page_of(station: Served, browser: str, folder: Path) -> Iterator[None]:
    """Its page, drawn by a browser without a window."""
    command = [browser, *FLAGS, f"--user-data-dir={folder}", station.url]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:  # noqa: S603
        try:
            time.sleep(DRAWN)
            if process.poll() is not None:
                raise CtrError(f"{browser} has ended with status {process.returncode}")
            yield
        finally:
            process.terminate()


def _address(process: "subprocess.Popen[bytes]", said: Path) -> str:
    begun = time.monotonic()
    while "is at http" not in (text := said.read_text(encoding="utf-8")):
        if process.poll() is not None or time.monotonic() - begun > PATIENCE:
            raise CtrError(f"the station did not start: {text.strip()}")
        time.sleep(0.05)
    return text.split("is at ")[1].split()[0]
