"""STOP stops a motion whatever else the page, its files, its storage or its network do, or the button says why not.

The browser reaches the station through a relay that can cut connections. Each test prints the time from the press to
the acknowledgement; `python -m tests.tools.stop_latency` measures it.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.harness.chromium import PATIENCE, SIZE, VISITED, chromium, open_tab, wait_until_loaded
from tests.harness.relay import Relay, of_all, relayed
from tests.harness.serving import Served, serving

HOLD = {"trajectory": {"kind": "hold"}, "duration": 600.0}
CAMERAS = """
[cameras.side]

[cameras.top]
pose = { position = [-0.4, 0.0, 0.13], rotation_vector = [2.221441469079183, 0.0, 2.221441469079183] }
"""
CONNECTIONS = 6  #: number of connections that Chromium opens to one server, for all its windows together
BLOCKED = """for (const name of ["localStorage", "sessionStorage"]) {
  Object.defineProperty(window, name, { get() { throw new DOMException("Access is denied", "SecurityError"); } });
}"""
FULL = """Storage.prototype.setItem = () => { throw new DOMException("exceeded the quota", "QuotaExceededError"); };"""
PICTURES = "() => [...document.querySelectorAll('.camera img')].filter((one) => one.naturalWidth === 640).length === 2"
OLD_BROWSER = "delete AbortSignal.any; delete AbortSignal.timeout;"


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving(settings=CAMERAS) as served:
        yield served


@pytest.fixture(scope="module")
def wire(running: Served) -> Iterator[Relay]:
    with relayed(running.port, of_all) as relay:
        yield relay


@pytest.fixture(scope="module")
def chrome(running: Served, wire: Relay) -> Iterator[Browser]:
    """A browser that reaches the station through the relay, at the name localhost."""
    with chromium(f"--host-resolver-rules=MAP localhost:{running.port} 127.0.0.1:{wire.port}") as browser:
        yield browser


@contextmanager
def window(chrome: Browser) -> Iterator[BrowserContext]:
    context = chrome.new_context(viewport=SIZE)
    context.set_default_timeout(PATIENCE)
    context.add_init_script(VISITED)
    context.route("**/viser/**", lambda route: route.abort())
    try:
        yield context
    finally:
        context.close()


def opened(context: BrowserContext, station: Served) -> Page:
    page = context.new_page()
    page.goto(f"http://localhost:{station.port}/", wait_until="commit")
    page.locator("#stop").wait_for()
    return page


def press_stops(station: Served, page: Page, situation: str) -> None:
    """Start a motion, press STOP, and wait until the station has stopped and the page has reported it."""
    station.ready()
    station.post("/api/start", HOLD)
    station.wait_for(lambda status: status["state"] == "RUNNING")
    page.evaluate("""() => {
      window.pressedAt = window.acknowledgedAt = null;
      document.addEventListener("stop-press", () => { window.pressedAt ??= performance.now(); });
      document.addEventListener("stop-report", () => { window.acknowledgedAt ??= performance.now(); });
    }""")
    page.locator("#stop").dispatch_event("pointerdown")  # Playwright's click waits for a page that is still loading
    station.wait_for(lambda status: status["state"] == "STOPPED")
    page.wait_for_function("() => window.acknowledgedAt !== null")
    seconds = page.evaluate("() => (window.acknowledgedAt - window.pressedAt) / 1000")
    print(f"STOP with {situation}: acknowledged after {seconds:.3f} s")  # noqa: T201
    expect(page.locator("#alarm", has_text="STOP is not")).to_have_count(0)


def works(page: Page) -> None:
    expect(page.locator("#stop-state")).to_have_text("")


@pytest.mark.parametrize("script", ["", BLOCKED, FULL, OLD_BROWSER], ids=["usual", "blocked", "full", "old browser"])
def test_stop_works_with_blocked_or_full_storage_and_in_an_old_browser(
    station: Served, chrome: Browser, script: str
) -> None:
    with window(chrome) as context:
        context.add_init_script(script)
        page = opened(context, station)
        works(page)
        if script != OLD_BROWSER:
            page.locator("#state", has_text="READY").wait_for()
            wait_until_loaded(page)
        press_stops(station, page, f"storage and browser: {script[:40]!r}")


def test_stop_works_while_pictures_occupy_every_connection(station: Served, chrome: Browser) -> None:
    with window(chrome) as context:
        page = opened(context, station)
        works(page)
        page.evaluate(
            """(count) => { for (let i = 0; i < count; i += 1) {
              document.body.append(Object.assign(new Image(), { src: `/api/cameras/side/stream?try=${i}` }));
            } }""",
            CONNECTIONS,
        )
        page.wait_for_function(
            """(count) => [...document.querySelectorAll("[src*=stream]")]
              .filter((one) => one.naturalWidth > 0).length >= count - 1""",
            arg=CONNECTIONS,
        )
        press_stops(station, page, "six connections in use")


def test_stop_and_data_arrive_in_three_windows_with_two_cameras_each(station: Served, chrome: Browser) -> None:
    with window(chrome) as context:
        pages = [opened(context, station) for _ in range(3)]
        for page in pages:
            wait_until_loaded(page)
            open_tab(page, "cameras")
            page.wait_for_function(PICTURES)
        press_stops(station, pages[0], "three windows with pictures")
        for page in pages:
            page.locator("#state", has_text="STOPPED").wait_for()


def without(path: str) -> Callable[[BrowserContext], None]:
    return lambda context: context.route(re.compile(re.escape(path)), lambda route: route.abort())


def late_modules(context: BrowserContext) -> None:
    context.route("**/static/**/*.js", lambda _: None)  # the answer never arrives


FILES = ["main.js", "page/station.js", "page/form.js", "scene/scene.js", "page/page.css"]


@pytest.mark.parametrize("lose", [*map(without, FILES), late_modules], ids=[*FILES, "all modules late"])
def test_stop_works_without_other_files_of_the_page(
    station: Served, chrome: Browser, lose: Callable[[BrowserContext], None], request: pytest.FixtureRequest
) -> None:
    with window(chrome) as context:
        lose(context)
        page = opened(context, station)
        works(page)
        press_stops(station, page, f"missing {request.node.callspec.id}")


def test_button_shows_a_lost_connection_and_stop_is_repeated_until_acknowledged(
    station: Served, chrome: Browser, wire: Relay
) -> None:
    with window(chrome) as context:
        page = opened(context, station)
        works(page)
        station.post("/api/start", HOLD)
        page.locator("#state", has_text="RUNNING").wait_for()
        page.evaluate("""() => {
          window.reports = [];
          document.addEventListener("stop-report", ({ detail }) => window.reports.push(detail));
        }""")
        wire.cut()
        try:
            expect(page.locator("#stop-state")).to_have_text("not connected")
            page.locator("#stop").click()
            page.locator(
                "#alarm", has_text=re.compile(r"STOP is not acknowledged by the station: tried \d+ times")
            ).wait_for()
            assert station.status()["state"] == "RUNNING"
        finally:
            wire.mend()
        station.wait_for(lambda status: status["state"] == "STOPPED")
        page.wait_for_function(
            "() => window.reports.some((one) => one.startsWith('STOP was accepted: acknowledged after'))"
        )
        expect(page.locator("#alarm")).to_be_hidden()
        works(page)


def test_button_shows_the_reason_behind_a_proxy_for_which_the_station_refuses_stop(
    station: Served, chrome: Browser, wire: Relay
) -> None:
    """A reverse proxy replaces the name of the host, if it is not configured to pass it on."""
    with window(chrome) as context:
        wire.replaced = (f"Host: localhost:{station.port}".encode(), f"Host: 127.0.0.1:{station.port}".encode())
        try:
            page = opened(context, station)
            expect(page.locator("#stop-state")).to_have_text("refused")
            reason = (
                f"STOP does not work in this page: requests from pages of 'http://localhost:{station.port}' are refused"
            )
            page.locator("#stop-refused", has_text=reason).wait_for()
        finally:
            wire.replaced = (b"", b"")


def test_waiting_request_is_cancelled_once_stop_is_acknowledged(station: Served, chrome: Browser) -> None:
    with window(chrome) as context:
        page = opened(context, station)
        works(page)
        context.route("**/api/stop", lambda _: None)  # the request waits in the browser
        with page.expect_event("requestfailed", lambda request: request.url.endswith("/api/stop")):
            press_stops(station, page, "a request that waits")
        expect(page.locator("#alarm")).to_be_hidden()
