"""Cold start of the page: requests, bytes and seconds until the tab Run is usable, quiet and beside a busy loop.

    python -m tests.tools.page_load [--scene] [--times N]

Each load has an empty cache. The tab is usable when the state is READY and the first experiment is shown. Without
`--scene` the scene is blocked, because drawing it without a graphics card occupies a processor.
"""

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from playwright.sync_api import Browser

from tests.harness.chromium import PATIENCE, SIZE, SLOWLY, chromium
from tests.harness.serving import serving


class Load(NamedTuple):
    """Numbers of one cold start."""

    requests: int  #: requests until the tab is usable, without polls of the status
    kilobytes: float  #: bytes on the wire [kB]
    seconds: float  #: time until the tab is usable [s]


def load(browser: Browser, url: str, *, scene: bool) -> Load:
    """Load the page in a context with an empty cache."""
    context = browser.new_context(viewport=SIZE)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.add_init_script(SLOWLY)
    network = context.new_cdp_session(page)
    network.send("Network.enable")
    if not scene:  # a blocked address costs nothing, while an intercepted one would delay every request
        network.send("Network.setBlockedURLs", {"urls": ["*/viser/*"]})
    addresses: dict[str, str] = {}
    sizes: dict[str, float] = {}

    def sent(event: Any) -> None:
        addresses[event["requestId"]] = event["request"]["url"]

    def finished(event: Any) -> None:
        sizes[event["requestId"]] = event["encodedDataLength"]

    network.on("Network.requestWillBeSent", sent)
    network.on("Network.loadingFinished", finished)
    begin = time.perf_counter()
    page.goto(url, wait_until="commit")
    page.locator("#state", has_text="READY").wait_for()
    page.locator(".card").first.wait_for()
    seconds = time.perf_counter() - begin
    context.close()
    counted = [size for one, size in sizes.items() if not addresses.get(one, "data:").startswith("data:")]
    polls = sum(address.endswith("/api/status") for address in addresses.values())
    return Load(len(counted) - polls, sum(counted) / 1e3, seconds)


@contextmanager
def busy_loop() -> Iterator[None]:
    """Occupy one processor."""
    program = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        program.kill()
        program.wait()


def report(name: str, loads: list[Load]) -> None:
    """Print the medians of several loads, and the range of their times."""
    requests, kilobytes, seconds = (statistics.median(values) for values in zip(*loads, strict=True))
    spread = f"{min(one.seconds for one in loads):.1f} ... {max(one.seconds for one in loads):.1f}"
    print(f"{name}: {requests:.0f} requests, {kilobytes:.0f} kB, {seconds:.2f} s ({spread})", flush=True)  # noqa: T201


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--scene", action="store_true", help="also load the scene")
    parser.add_argument("--times", type=int, default=5, metavar="N", help="loads per median (default: 5)")
    parsed = parser.parse_args()
    with serving(rate=1.0) as station, chromium() as browser:
        station.wait_for(lambda status: status["state"] == "READY")
        load(browser, station.url, scene=parsed.scene)  # the station checks the experiments at the first load
        report("quiet", [load(browser, station.url, scene=parsed.scene) for _ in range(parsed.times)])
        with busy_loop():
            report("beside a busy loop", [load(browser, station.url, scene=parsed.scene) for _ in range(parsed.times)])


if __name__ == "__main__":
    main()
