"""The Chromium of this computer, and the page of a station in it."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Locator, Page, Request, ViewportSize, expect, sync_playwright

from tests.harness.serving import Served
from tests.harness.waiting import NET, until

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
expect.set_options(timeout=PATIENCE)
#: Time after which a press without any effect counts as lost [s].
LOST_AFTER_S = 20.0
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


#: One element of each module of the page, which the modules add when they are loaded.
MODULES = [
    "#strip output", "#start :is(.card, form)", "#jog form", "#hands fieldset", "#devices h3", "#plots .chart",
    "#runs .acts", "#calibrate > *", "#faults form", "#help", "#palette",
]  # fmt: skip


def wait_until_loaded(page: Page) -> None:
    """Wait until every module of the page is loaded; a press before that would have no effect."""
    page.wait_for_function("all => all.every((one) => document.querySelector(one) !== null)", arg=MODULES)


def wait_until_current(page: Page) -> None:
    """Wait until the page has current data; without them Escape is STOP, and most commands are disabled."""
    page.locator("body:not(.stale)").wait_for()


#: Check the data's age and press within one task of the page.
ESCAPE = """async () => {
  const { dataAge, STALE_AFTER_S } = await import("/static/page/station.js");
  if (dataAge() > STALE_AFTER_S) return false;
  const press = new KeyboardEvent("keydown", { key: "Escape", bubbles: true, cancelable: true });
  document.activeElement.dispatchEvent(press);
  return true;
}"""


def press_escape(page: Page) -> None:
    """Press Escape while the page has current data, without which Escape is STOP.

    On a busy computer the data may become old between a wait for current data and a press of the keyboard.
    """
    until(lambda: page.evaluate(ESCAPE))  # wait_for_function takes the promise of an async function for true


def press_until(page: Page, press: Callable[[], object], happened: Callable[[], bool]) -> None:
    """Press until the effect has happened.

    On a busy computer the page may refuse a press because its data are too old, or it may disable the button during
    the press, which is then lost; the user presses again.
    """
    refused = page.locator(".note", has_text="Not started")
    while not happened():
        for note in refused.all():
            note.get_by_role("button", name="close").click()
        press()
        lost = time.monotonic() + LOST_AFTER_S
        until(lambda lost=lost: happened() or refused.count() > 0 or time.monotonic() > lost)


def press_until_asked(page: Page, press: Callable[[], object]) -> Locator:
    """Press until the page asks for a confirmation; return the question."""
    question = page.locator("#question")
    press_until(page, press, question.is_visible)
    return question


def press_until_sent(page: Page, press: Callable[[], object], path: str = "/api/start", method: str = "POST") -> None:
    """Press until the page has sent a command to `path`."""
    sent: list[Request] = []

    def note(request: Request) -> None:
        if request.method == method and request.url.endswith(path):
            sent.append(request)

    page.on("request", note)
    try:
        press_until(page, press, lambda: len(sent) > 0)
    finally:
        page.remove_listener("request", note)


def open_tab(page: Page, name: str) -> None:
    """Open a tab of the page, and first the tab around it.

    The end of a run moves the tabs, because its result appears above them; a press in this moment may miss its tab.
    """
    for one in ("bench", name) if name in ("devices", "calibrate", "faults") else (name,):
        tab = page.locator(f"#tab-{one}")
        press_until(page, tab.click, lambda tab=tab: tab.get_attribute("aria-selected") == "true")


@contextmanager
def bare_page(
    browser: Browser, station: Served, query: str = "", script: str = VISITED, **options: Any
) -> Iterator[Page]:
    """Yield the page of a separate client without the scene, because drawing the scene occupies a processor.

    `script` runs before those of the page; `options` are those of the browser's context.
    """
    context = browser.new_context(**{"viewport": SIZE, **options})
    context.set_default_timeout(PATIENCE)
    context.add_init_script(script)
    page = context.new_page()
    page.route("**/viser/**", lambda route: route.abort())
    page.goto(f"{station.url}/{query}")
    page.locator("#state", has_text="READY").wait_for()
    wait_until_loaded(page)
    try:
        yield page
    finally:
        context.close()
