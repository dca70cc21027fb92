"""STOP of a page works without each of its files in turn; `live/browser/test_stop_ways.py` has some of the files."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.harness.chromium import chromium
from tests.harness.serving import Served, serving
from tests.live.browser.test_stop_ways import opened, press_stops, window, without, works
from web.static_files import STATIC, STOP_SCRIPT

FILES = sorted(path.relative_to(STATIC).as_posix() for ending in ("*.js", "*.css") for path in STATIC.rglob(ending))
FILES.remove(STOP_SCRIPT)


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving() as served:
        yield served


@pytest.fixture(scope="module")
def chrome() -> Iterator[Browser]:
    with chromium("--host-resolver-rules=MAP localhost 127.0.0.1") as browser:
        yield browser


@pytest.mark.parametrize("path", FILES)
def test_stop_works_without_one_file_of_the_page(running: Served, chrome: Browser, path: str) -> None:
    with window(chrome) as context:
        without(f"/static/{path}")(context)
        page = opened(context, running)
        works(page)
        press_stops(running, page, f"missing {path}")
