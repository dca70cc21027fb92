"""The page guides the user through a calibration, from the first card to the report."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from station.config.strict import PRESETS
from tests.harness.chromium import open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served, serving

Picture = Callable[[Page, str], None]
SEED = 4


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving("--lab", "uncalibrated", "--seed", str(SEED)) as served:
        yield served


@pytest.fixture
def calibrate(page: Page) -> Page:
    open_tab(page, "calibrate")
    back = page.get_by_role("button", name="all procedures")
    if back.count():
        back.click()
    page.locator("#calibrate .card", has_text="Axes").wait_for()
    return page


def begin(page: Page, card: str, picture: Picture | None = None) -> None:
    """Start a procedure from its card and confirm the question."""
    page.locator("#calibrate .card", has_text=card).first.click()
    if page.get_by_label("effort").count():
        page.get_by_label("effort").select_option("0.5")
    if page.get_by_label("known weights").count():
        page.get_by_label("known weights").fill("0.5")
    if picture is not None:
        picture(page, "calibrate_offer")
    dialog = press_until_asked(page, page.get_by_role("button", name="Start: ").click)
    dialog.get_by_text("Is the path clear").wait_for()
    expect(dialog.get_by_role("button", name="Start", exact=True)).to_be_disabled()
    dialog.get_by_role("checkbox").check()
    dialog.get_by_role("button", name="Start", exact=True).click()
    page.locator("#course progress").wait_for()


def test_latency_calibration_on_the_page_is_applied_to_the_station_file_and_undone(
    calibrate: Page, station: Served, picture: Picture
) -> None:
    page = calibrate
    picture(page, "calibrate")
    begin(page, "Latency", picture)
    page.locator("#course .ended", has_text="done").wait_for()
    page.get_by_role("button", name="Show results").click()
    page.locator("#found").wait_for()
    picture(page, "calibrate_found")
    report = page.get_by_role("link", name="Report with figures").get_attribute("href")
    assert "Everything here comes from simulated devices" in station.rest.get(report).text
    (result,) = station.rest.get("/api/calibration/results").json()
    found = station.rest.get(f"/api/calibration/results/{result['name']}").json()
    assert {"report.html", "report.json", "visits.json"} <= set(found["files"])
    assert found["found"]
    assert station.status()["state"] == "READY"
    known = station.rest.get("/api/calibration").json()
    file, before = Path(known["file"]), Path(known["file"]).read_text(encoding="utf-8")
    press_until_asked(page, page.get_by_role("button", name="Apply…").click)
    page.get_by_role("dialog").get_by_role("button", name="Apply", exact=True).click()
    page.get_by_role(
        "button", name="Undo…"
    ).wait_for()  # the page was loaded again, from a station that uses the result
    (line,) = set(file.read_text(encoding="utf-8").splitlines()) - set(before.splitlines())
    assert line == f'calibration = "{known["folder"]}/{result["name"]}"'
    page.locator("#state", has_text="READY").wait_for()
    press_until_asked(page, page.get_by_role("button", name="Undo…").click)
    page.get_by_role("dialog").get_by_role("button", name="Undo", exact=True).click()
    page.get_by_text("The station uses no calibration.").wait_for()
    assert file.read_text(encoding="utf-8") == before
    page.locator("#state", has_text="READY").wait_for()


ASKS = {
    "what": "force", "stage": "asking", "on": True, "done": 0.3, "message": "weight 0.5 N",
    "instruction": "Hang a weight of 0.5 N at the tip.", "weight": 0.5, "elapsed": 100.0, "left": 200.0, "result": "",
}  # fmt: skip


def test_calibrate_tab_requests_a_weight_and_accepts_the_confirmation_by_keyboard(
    calibrate: Page, picture: Picture
) -> None:
    """The page receives simulated answers, because a real procedure takes minutes; `tests/virtual` attaches weights."""
    page, confirmed = calibrate, []

    def asks(route: Route) -> None:
        course = ASKS | {"stage": "moving", "instruction": "", "message": "pose 8"} if confirmed else ASKS
        route.fulfill(json=route.fetch().json() | {"course": course})

    def done(route: Route) -> None:
        confirmed.append(route.request.method)
        route.fulfill(json={"course": ASKS})

    page.route("**/api/calibration", asks)
    page.route("**/api/calibration/done", done)
    try:
        page.locator("#course .task:visible", has_text="Hang a weight of 0.5 N at the tip.").wait_for()
        picture(page, "calibrate_ask")
        # The button has the keyboard focus, because the user's hands are busy at the tip.
        expect(page.get_by_role("button", name="Weight attached")).to_be_focused()
        page.keyboard.press("Enter")
        page.locator("#course .task").wait_for(state="hidden")
        assert confirmed == ["POST"]
    finally:
        page.unroute_all(behavior="wait")  # an answer to a poll may still be on its way


def test_opened_form_stays_when_a_calibration_ends(calibrate: Page) -> None:
    page, courses = calibrate, [ASKS]
    page.route("**/api/calibration", lambda route: route.fulfill(json=route.fetch().json() | {"course": courses[-1]}))
    try:
        page.locator("#course .task:visible").wait_for()
        page.locator("#calibrate .card", has_text="Axes").click()
        courses.append(ASKS | {"stage": "stopped", "on": False, "instruction": ""})
        page.locator("#course .ended:visible").wait_for()
        page.get_by_role("button", name="Start: ").wait_for()
        page.get_by_role("button", name="Dismiss").click()
    finally:
        page.unroute_all(behavior="wait")


def test_aborted_calibration_writes_no_result_and_shows_the_cause(
    calibrate: Page, station: Served, picture: Picture
) -> None:
    page = calibrate
    before = station.rest.get("/api/calibration/results").json()
    begin(page, "Axes")
    station.wait_for(lambda status: status["state"] == "RUNNING")
    page.get_by_role("button", name="Abort").click()
    page.locator("#course .ended", has_text="aborted by the operator").wait_for()
    page.locator("#state", has_text="STOPPED").wait_for()
    picture(page, "calibrate_aborted")
    page.get_by_role("button", name="Dismiss").click()
    page.locator("#course .ended").wait_for(state="hidden")
    assert station.rest.get("/api/calibration/results").json() == before
    page.locator("#calibrate .card", has_text="Axes").click()
    page.locator("#calibrate", has_text="not while STOPPED").wait_for()
    expect(page.get_by_role("button", name="Start: ")).to_be_disabled()
    press_until_sent(page, page.locator("#reset").click, "/api/reset")
    page.locator("#state", has_text="READY").wait_for()
    page.wait_for_function("() => !document.querySelector('#calibrate button.main[type=submit]').disabled")


def test_shift_space_stops_a_calibration(calibrate: Page, station: Served) -> None:
    page = calibrate
    begin(page, "Latency")
    station.wait_for(lambda status: status["state"] == "RUNNING")
    page.keyboard.press("Shift+Space")
    page.locator("#course .ended", has_text="STOPPED").wait_for()
    page.get_by_role("button", name="Dismiss").click()


def test_tube_exchange_shows_a_checklist_for_the_selected_robot(calibrate: Page, picture: Picture) -> None:
    page = calibrate
    page.locator("#calibrate .card", has_text="Tube exchange").click()
    page.get_by_label("robot with the new tubes").select_option("three_tubes")
    page.locator(".todo li", has_text="EI, curvature").wait_for()
    page.locator(".todo li").first.filter(has_text="power off").wait_for()
    picture(page, "calibrate_exchange")
    text = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")
    page.get_by_label("robot's file").set_input_files(
        {"name": "own.toml", "mimeType": "application/toml", "buffer": text.encode()}
    )
    page.locator(".todo li", has_text="The coil was removed").wait_for()
    page.get_by_label("robot's file").set_input_files(
        {"name": "large.toml", "mimeType": "application/toml", "buffer": bytes(2_000_000)}
    )
    page.locator(".note", has_text="The file has 2000000 bytes; a robot's file has at most 50000").wait_for()
    page.locator(".todo").get_by_role("button", name="Tracker").click()
    page.get_by_role("button", name="Start: Tracker").wait_for()


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (1024, 768), (820, 1180)])
def test_calibrate_tab_fits_small_screens(calibrate: Page, width: int, height: int) -> None:
    page = calibrate
    page.set_viewport_size({"width": width, "height": height})
    try:
        panel = page.locator("#calibrate")
        assert panel.evaluate("element => element.scrollWidth - element.clientWidth") <= 1
        assert page.locator("#tabs").evaluate("element => element.scrollWidth - element.clientWidth") <= 1
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})
