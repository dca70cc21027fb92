"""Pages with their scene drawn."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.harness.chromium import scene_page
from tests.harness.serving import Served


@pytest.fixture(scope="module")
def open_page(running: Served, browser: Browser) -> Iterator[Page]:
    """Open one page with its scene for all tests of a module, because software rendering is slow."""
    running.ready()
    page = scene_page(browser)
    page.goto(running.url)
    page.frame_locator("#scene").locator("canvas").first.wait_for()
    page.locator("#tip canvas").wait_for()
    page.wait_for_timeout(4000)
    yield page
    page.close()
