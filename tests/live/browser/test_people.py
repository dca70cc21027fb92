"""Several clients, some of them hostile: two operators, a viewer, a page of another site."""

import http.server
import threading
from collections.abc import Iterator

import pytest
import viser
from playwright.sync_api import Browser, Page, expect

from tests.harness.chromium import bare_page, press_until_asked, press_until_sent
from tests.harness.serving import Served, serving
from tests.harness.waiting import until

HOLD = {"trajectory": {"kind": "hold"}, "duration": 60.0}


def become_operator(page: Page, name: str, button: str) -> None:
    press_until_asked(page, page.get_by_role("button", name=button).click)
    page.get_by_label("your name").fill(name)
    page.get_by_role("dialog").get_by_role("button", name=button.removesuffix("…")).click()
    page.locator("#operator", has_text="You are operator").wait_for()


def test_two_browsers_share_one_operator_lease(station: Served, browser: Browser) -> None:
    with bare_page(browser, station) as anna, bare_page(browser, station) as ben:
        become_operator(anna, "Anna", "Take control")
        ben.locator("#operator", has_text="Operator: Anna").wait_for()
        ben.locator(".card", has_text="Keep the tip where it is").click()
        ben.locator("#start", has_text="'Anna' is operator").wait_for()
        expect(ben.get_by_role("button", name="Start motion")).to_be_disabled()
        anna.locator(".card", has_text="Keep the tip where it is").click()
        press_until_sent(anna, anna.get_by_role("button", name="Start motion").click)
        ben.locator("#state", has_text="RUNNING").wait_for()
        # Every client may send STOP.
        ben.locator("#stop").click()
        anna.locator("#state", has_text="STOPPED").wait_for()
        expect(ben.locator("#reset")).to_be_disabled()
        ben.locator("#next", has_text="only operator 'Anna' can reset").wait_for()
        become_operator(ben, "Ben", "Take over…")
        anna.locator("#operator", has_text="Operator: Ben").wait_for()
        press_until_sent(ben, ben.locator("#reset").click, "/api/reset")
        anna.locator("#state", has_text="READY").wait_for()
        ben.get_by_role("button", name="Release").click()
        anna.locator("#operator", has_text="No operator").wait_for()


@pytest.fixture
def hostile_site() -> Iterator[str]:
    class Site(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>evil</title><body>evil</body>")

        def log_message(self, *_: object) -> None:
            return

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Site)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


ATTACK = """async (station) => {
  const tried = {};
  const attempt = async (name, act) => {
    try { tried[name] = await act(); } catch (error) { tried[name] = 'blocked'; }
  };
  const json = {method: 'POST', headers: {'content-type': 'application/json'}, body: '{}'};
  await attempt('read', async () => (await fetch(station + '/api/status')).status);
  await attempt('json', async () => (await fetch(station + '/api/start', json)).status);
  await attempt('blind', async () => (await fetch(station + '/api/start', {method: 'POST', mode: 'no-cors'})).type);
  await attempt('beacon', async () => navigator.sendBeacon(station + '/api/start', '{}') ? 'sent' : 'blocked');
  const socket = (path) => new Promise((resolve) => {
    const protocol = path.includes('viser') ? ['viser-v%s'] : undefined;
    const ws = new WebSocket(station.replace('http', 'ws') + path, protocol);
    ws.onopen = () => resolve('open');
    ws.onerror = () => resolve('blocked');
  });
  await attempt('scene', () => socket('/viser/'));
  await attempt('telemetry', () => socket('/api/telemetry'));
  const frame = document.createElement('iframe');
  frame.src = station + '/';
  document.body.append(frame);
  const form = document.createElement('form');
  Object.assign(form, {method: 'POST', action: station + '/api/start', enctype: 'text/plain', target: 'elsewhere'});
  const place = document.createElement('iframe');
  place.name = 'elsewhere';
  document.body.append(place, form);
  form.submit();
  await new Promise((resolve) => setTimeout(resolve, 1500));
  return tried;
}"""


def test_page_of_another_site_reads_nothing_and_moves_nothing(
    station: Served, browser: Browser, hostile_site: str
) -> None:
    page = browser.new_page()
    try:
        page.goto(hostile_site)
        tried = page.evaluate(ATTACK.replace("%s", viser.__version__), station.url)
        assert all(frame.locator("#stop").count() == 0 for frame in page.frames)
    finally:
        page.close()
    assert {tried[name] for name in ("read", "json", "scene", "telemetry")} == {"blocked"}
    status = station.status()
    assert status["state"] == "READY"
    assert status["operator"]["name"] is None
    log = "/api/log?count=50"
    until(lambda: sum(hostile_site[:-1] in entry["outcome"] for entry in station.rest.get(log).json()) >= 3)


# ---- beyond loopback

RESET = """() => fetch('/api/reset', {method: 'POST', headers: {'content-type': 'application/json'}, body: '{}'})
  .then((answer) => answer.status)"""


@pytest.fixture(scope="module")
def guarded() -> Iterator[Served]:
    with serving("--host", "0.0.0.0") as served:
        yield served


def test_viewer_may_view_and_press_stop_but_starts_nothing(guarded: Served, browser: Browser) -> None:
    viewer, _ = guarded.tokens
    guarded.ready()
    with bare_page(browser, guarded, f"?token={viewer}") as page:
        assert "token" not in page.url
        expect(page.locator("#operator-act")).to_be_hidden()
        page.locator(".card", has_text="Keep the tip where it is").click()
        page.locator("#start", has_text="A viewer may only view").wait_for()
        assert guarded.post("/api/start", HOLD).status_code == 202
        page.locator("#state", has_text="RUNNING").wait_for()
        page.keyboard.press("Shift+Space")
        guarded.wait_for(lambda s: s["state"] == "STOPPED")
        page.locator("#next", has_text="an operator can reset").wait_for()
        assert page.evaluate(RESET) == 403
        assert "token" not in page.evaluate("document.cookie")


def test_operators_token_may_take_control(guarded: Served, browser: Browser) -> None:
    _, operator = guarded.tokens
    guarded.ready()
    with bare_page(browser, guarded, f"?token={operator}") as page:
        become_operator(page, "Anna", "Take control")
