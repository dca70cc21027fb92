"""A real Chromium on a real station. Without a Chromium these tests are deselected, and the last line reports it."""

import os
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests.harness.chromium import CHROMIUM, bare_page, chromium
from tests.harness.serving import Served
from tests.harness.shared import Shared

HERE = Path(__file__).parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if CHROMIUM is not None:
        return
    if os.environ.get("CTR_STATION_BROWSER") == "required":
        raise pytest.UsageError("no Chromium found, and CTR_STATION_BROWSER=required")
    mine = [item for item in items if item.path.is_relative_to(HERE)]
    config.hook.pytest_deselected(items=mine)
    items[:] = [item for item in items if item not in mine]
    config.stash[_DESELECTED] = len(mine)


def pytest_unconfigure(config: pytest.Config) -> None:
    if count := config.stash.get(_DESELECTED, 0):
        print(f"{count} browser tests were deselected: no Chromium found (install chromium to run them)")  # noqa: T201


_DESELECTED = pytest.StashKey[int]()


_BROWSER = pytest.StashKey[Shared[Browser]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """End the shared browser before a test that does not use it; Playwright's event loop would disturb other tests."""
    try:
        return (yield)
    finally:  # also after a failed teardown
        if nextitem is None or "browser" not in getattr(nextitem, "fixturenames", ()):
            _shared(item.session).end()


def _shared(session: pytest.Session) -> Shared[Browser]:
    return session.stash.setdefault(_BROWSER, Shared(chromium))


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Browser:
    return _shared(request.session)()


@pytest.fixture(scope="module")
def open_page(running: Served, browser: Browser) -> Iterator[Page]:
    """One page per test module, without the scene."""
    running.ready()
    with bare_page(browser, running) as page:
        yield page


@pytest.fixture
def page(station: Served, open_page: Page) -> Page:
    """The module's page, on a station that is READY."""
    open_page.locator("#state", has_text="READY").wait_for()
    return open_page


@pytest.fixture
def first_visit(station: Served, browser: Browser) -> Iterator[Page]:
    """A page that welcomes its user."""
    with bare_page(browser, station, script="") as page:
        page.locator("#welcome").wait_for()
        yield page
    station.rest.delete("/api/queue")


@pytest.fixture
def picture(tmp_path: Path) -> Callable[[Page, str], None]:
    """Take a picture of the page; the folder CTR_STATION_PICTURES keeps the pictures."""
    folder = Path(os.environ.get("CTR_STATION_PICTURES", tmp_path))

    def take(page: Page, name: str) -> None:
        # This function writes the picture itself, because the library would leave a thread behind.
        (folder / f"{name}.png").write_bytes(page.screenshot())

    return take
