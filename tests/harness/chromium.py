"""The browser of this computer, and the page of a station in it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, Page

from tests.harness.serving import Served

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
SIZE = {"width": 1280, "height": 720}


@contextmanager
def bare_page(browser: Browser, station: Served, query: str = "") -> Iterator[Page]:
    """The page of a person of its own, without the scene: it takes a processor to draw."""
    context = browser.new_context(viewport=SIZE)
    page = context.new_page()
    page.route("**/viser/**", lambda route: route.abort())
    page.goto(f"{station.url}/{query}")
    page.locator("#state", has_text="READY").wait_for(timeout=20_000)
    page.locator(".card").first.wait_for(timeout=60_000)
    try:
        yield page
    finally:
        context.close()
