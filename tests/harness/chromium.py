"""The Chromium of this computer, and the page of a station in it."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from tests.harness.serving import Served
from tests.harness.waiting import NET

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
]  # fmt: skip
#: Script that starts Chromium with normal priority, because Chromium as root raises its priority above the stations'.
GENTLY = Path(__file__).with_name("gentle_chromium")
#: Timeout of everything for which a test waits in a page [ms].
PATIENCE = 1e3 * NET
SIZE: ViewportSize = {"width": 1280, "height": 720}
#: Device scale factor of pages. Without a graphics card the scene takes a whole processor; with coarse pixels and four
#: pictures a second it takes a fifth. Pictures that are kept for the documents are drawn finely.
COARSE = 1.0 if "CTR_STATION_PICTURES" in os.environ else 0.4
SLOWLY = """
const now = () => performance.now();
window.requestAnimationFrame = (draw) => setTimeout(() => draw(now()), 250);
window.cancelAnimationFrame = (drawing) => clearTimeout(drawing);
"""


#: The browser has visited the page before, so that the page does not welcome its user.
VISITED = "localStorage.setItem('welcomed', 'yes')"


def scene_page(browser: Browser) -> Page:
    """Return a page whose scene is drawn coarsely and at a low rate, to save processor time."""
    page = browser.new_page(viewport=SIZE, device_scale_factor=COARSE)
    page.set_default_timeout(PATIENCE)
    page.add_init_script(VISITED)
    page.add_init_script(SLOWLY)
    return page


@contextmanager
def chromium(*flags: str) -> Iterator[Browser]:
    """Yield a browser with normal priority."""
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(
            executable_path=GENTLY, args=[*FLAGS, *flags], env={**os.environ, "CHROMIUM": str(CHROMIUM)}
        ) as browser,
    ):
        yield browser


def open_tab(page: Page, name: str) -> None:
    """Open a tab of the page, and first the tab around it."""
    if name in ("devices", "calibrate", "faults"):
        page.locator("#tab-bench").click()
    page.locator(f"#tab-{name}").click()


@contextmanager
def bare_page(browser: Browser, station: Served, query: str = "") -> Iterator[Page]:
    """Yield the page of a separate client without the scene, because drawing the scene occupies a processor."""
    context = browser.new_context(viewport=SIZE)
    context.set_default_timeout(PATIENCE)
    context.add_init_script(VISITED)
    page = context.new_page()
    page.route("**/viser/**", lambda route: route.abort())
    page.goto(f"{station.url}/{query}")
    page.locator("#state", has_text="READY").wait_for()
    page.locator(".card").first.wait_for()
    try:
        yield page
    finally:
        context.close()
