"""Touch on the page: the dial of a held force, the form in Jog that starts it, and the stiffness of the tip."""

import json
import math
import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect
from websockets.sync.client import connect

from tests.harness.chromium import open_tab, press_until_sent
from tests.harness.serving import Served
from tests.harness.waiting import until
from tests.live.browser.test_accessibility import SIZES, violations

FORCE_N = 0.2
WALL = {"kind": "wall", "direction": [-1.0, 0.0, 0.0], "distance": 0.004, "stiffness": 1000.0}
MOTION = {"kind": "force", "direction": [1.0, 0.0, 0.0], "force": FORCE_N}
PRESS = {"trajectory": MOTION, "duration": 600.0}
#: JavaScript that returns the angle of a dial's needle from up, clockwise [deg].
NEEDLE = """dial => { const { transform } = getComputedStyle(dial.querySelector(".needle"));
  const { a, b } = new DOMMatrix(transform); return Math.atan2(b, a) * 180 / Math.PI; }"""


@pytest.fixture
def jog(station: Served, page: Page) -> Iterator[Page]:
    """The tab Jog at the usual pose, without an operator."""
    assert station.post("/api/goto").status_code == 202
    station.wait_for(lambda s: s["state"] == "READY" and abs(s["joints"]["inner_translation"] + 0.1) < 1e-4)
    station.rest.delete("/api/operator")
    open_tab(page, "jog")
    yield page
    station.ready()


def pressing(station: Served, load: dict[str, Any]) -> None:
    """Start a press with 0.2 N along +x, and wait until the tip moves."""
    assert station.post("/api/start", PRESS | {"load": load}).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving" or s["state"] != "RUNNING")
    assert station.status()["state"] == "RUNNING", station.status()["cause"]


def started(page: Page, button: Locator) -> dict[str, Any]:
    """Press a button that starts a run, and wait until it runs; return the request."""
    sent: list[Any] = []
    page.on("request", lambda request: sent.append(request.post_data_json) if "/api/start" in request.url else None)
    press_until_sent(page, button.click)
    page.locator("#state", has_text="RUNNING").wait_for()
    return sent[-1]


def test_dial_shows_force_contact_and_bound_of_a_held_force(station: Served, jog: Page) -> None:
    page = jog
    bound = station.rest.get("/api/rig").json()["max_force"]
    open_tab(page, "start")
    dial = page.locator("#now .dial")
    expect(dial).to_be_hidden()
    pressing(station, WALL)
    expect(dial.locator(".contact")).to_have_text(re.compile(r"in contact for \d+ s"))
    meter = dial.get_by_role("meter", name="force of the tip")
    expect(meter).to_have_attribute("aria-valuemax", f"{bound:.2f}")
    until(lambda: abs(float(meter.get_attribute("aria-valuenow") or "nan") - FORCE_N) <= 0.02)
    expect(meter).to_have_attribute("aria-valuetext", re.compile(r"^0\.\d\d N of 0\.20 N, in contact$"))
    expect(dial.locator(".number")).to_have_text(re.compile(r"^0\.(1[89]|2[0-2])$"))
    expect(dial.locator("dd")).to_have_text(["0.20 N", "+x", re.compile(r"^0\.[2-4]\d N$"), f"{bound:.2f} N"])
    # The drawing has 224 deg for 1.15 times the bound; its middle is up.
    expected = -112.0 + 224.0 * FORCE_N / (1.15 * bound)
    until(lambda: abs(float(dial.evaluate(NEEDLE)) - expected) < 6.0)
    station.post("/api/stop")
    page.locator("#state", has_text="STOPPED").wait_for()
    expect(dial).to_be_hidden()


def test_time_of_the_contact_is_that_of_the_station_in_a_page_that_opens_later(station: Served, jog: Page) -> None:
    page = jog
    pressing(station, WALL)
    open_tab(page, "start")
    since = page.locator("#now .contact span")
    expect(since).to_have_text(re.compile("for [3-9] s"))
    page.evaluate("sessionStorage.clear()")
    page.goto("about:blank")
    page.goto(station.url)
    expect(since).to_have_text(re.compile(r"for ([4-9]|[1-9]\d+) s"))


def test_dial_without_an_obstacle_shows_no_contact(station: Served, jog: Page) -> None:
    page = jog
    open_tab(page, "start")
    pressing(station, {"kind": "none"})
    dial = page.locator("#now .dial")
    expect(dial.locator(".contact")).to_have_text("no contact")
    expect(dial.get_by_role("meter")).to_have_attribute("aria-valuetext", re.compile("no contact$"))


def test_press_in_jog_starts_a_run_with_the_chosen_values_and_stop_ends_it(station: Served, jog: Page) -> None:
    page = jog
    form = page.locator("#press")
    form.get_by_label("\u2212x", exact=True).check(force=True)
    form.get_by_label("force", exact=True).fill("0.15")
    form.get_by_label("speed").fill("4")
    form.get_by_label("reach").fill("15")
    form.get_by_label("duration").fill("90")
    form.get_by_label("simulated obstacle").select_option("wall, 4 mm ahead")
    button = form.get_by_role("button", name="Press with 0.15 N along \u2212x")

    body = started(page, button)

    motion = body["trajectory"]
    assert motion == {"kind": "force", "direction": [-1, 0, 0], "force": 0.15, "speed": 0.004, "reach": 0.015}
    assert body["load"] == {"kind": "wall", "direction": [1, 0, 0], "distance": 0.004, "stiffness": 1000}
    assert body["duration"] == 90
    expect(form.locator(".dial dd").first).to_have_text("0.15 N")
    expect(form.locator(".contact")).to_have_text(re.compile("in contact"))
    expect(button).to_be_hidden()
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
    expect(form.locator(".dial")).to_be_hidden()
    expect(button).to_be_disabled()


def test_press_along_the_tip_has_the_direction_of_the_model_at_the_current_pose(station: Served, jog: Page) -> None:
    page = jog
    joints = station.status()["joints"]
    axis = station.post("/api/model/solve", {"joints": joints}).json()["direction"]
    page.locator("#press").get_by_label("along the tip's axis, backward").check(force=True)

    body = started(page, page.locator("#press").get_by_role("button", name=re.compile("backward$")))

    along = body["trajectory"]["direction"]
    assert math.dist(along, [-x for x in axis]) < 0.05  # noise of 0.08 N bends the model's tip by 0.02
    assert math.hypot(*along) == pytest.approx(1.0, abs=1e-6)


def test_force_above_its_bound_is_refused_by_form_and_station(station: Served, jog: Page) -> None:
    page = jog
    largest = station.rest.get("/api/rig").json()["max_desired_force"]
    field = page.locator("#press").get_by_label("force", exact=True)
    assert largest - 0.01 < field.evaluate("field => field.bounds.max") <= largest
    field.fill("0.7")
    page.locator("#press button.main").click()
    assert field.evaluate("field => field.matches(':invalid')")
    refused = station.post("/api/start", {"trajectory": MOTION | {"force": 0.7}})
    assert refused.status_code == 422
    assert "0.7 N is above 0.624 N" in refused.json()["error"]
    assert station.status()["state"] == "READY"
    field.fill("0.2")


def test_stiffness_needs_three_values_and_is_sent_with_the_motion(station: Served, jog: Page) -> None:
    page = jog
    open_tab(page, "start")
    if page.get_by_role("button", name="all motions").count():
        page.get_by_role("button", name="all motions").click()
    page.locator(".card", has_text="Keep the tip where it is").click()
    start = page.get_by_role("button", name="Start motion")
    box = page.locator("#start fieldset", has_text="Stiffness of the tip")
    expect(box).to_contain_text("the tubes alone have")
    box.get_by_label("along x").fill("60")
    start.click()
    assert box.get_by_label("along z").evaluate("field => field.matches(':invalid')")
    assert station.status()["state"] == "READY"
    box.get_by_label("along y").fill("60")
    box.get_by_label("along z").fill("300")
    box.get_by_label("stiffness frame").select_option("tip")
    box.get_by_label("max offset").fill("5")

    body = started(page, start)

    assert body["controller"]["stiffness"] == [60, 60, 300]
    assert body["controller"]["stiffness_frame"] == "tip"
    assert body["controller"]["max_offset"] == pytest.approx(0.005)
    page.get_by_role("button", name="Motions", exact=True).click()
    page.get_by_role("button", name="all motions").click()


def test_stiffness_is_changed_while_a_motion_with_a_stiffness_runs(station: Served, jog: Page) -> None:
    page = jog
    open_tab(page, "start")
    fields = page.locator("#stiffness")
    motion = {"trajectory": {"kind": "hold"}, "duration": 600.0}
    station.post("/api/start", motion)
    page.locator("#run-left", has_text="left of").wait_for()
    expect(fields).to_contain_text("fill in “Stiffness of the tip” before you start it")
    station.ready()
    page.locator("#state", has_text="READY").wait_for()  # otherwise the page may fill the fields of the first run

    controller = {"strategy": "dual_layer", "stiffness": [60.0, 60.0, 300.0], "stiffness_frame": "tip"}
    station.post("/api/start", motion | {"controller": controller})
    expect(fields.get_by_label("stiffness z")).to_have_value("300")
    fields.get_by_label("stiffness z").fill("0")
    fields.get_by_role("button", name="Set stiffness").click()
    assert fields.get_by_label("stiffness z").evaluate("field => field.matches(':invalid')")
    fields.get_by_label("stiffness z").fill("500")
    with page.expect_request("**/api/stiffness") as sent:
        press_until_sent(page, fields.get_by_role("button", name="Set stiffness").click, "/api/stiffness", "PUT")
    assert sent.value.post_data_json == {"stiffness": [60, 60, 500]}
    page.locator(".note.good", has_text="the tip reaches this stiffness within 1 s").wait_for()
    with connect(f"ws://127.0.0.1:{station.port}/api/telemetry?rate=50", proxy=None) as telemetry:
        while (sample := json.loads(telemetry.recv()))["stiffness"] != [60.0, 60.0, 500.0]:
            assert sample["phase"] == "moving"


def test_motion_that_holds_a_force_offers_no_stiffness(jog: Page) -> None:
    page = jog
    open_tab(page, "start")
    page.locator(".card", has_text="Approach along a direction").click()
    expect(page.locator("#start form")).to_contain_text("Control")
    expect(page.locator("#start fieldset", has_text="Stiffness of the tip")).to_have_count(0)
    page.get_by_role("button", name="all motions").click()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_axe_finds_no_violation_while_a_force_is_held(station: Served, jog: Page, width: int, height: int) -> None:
    page = jog
    page.set_viewport_size({"width": width, "height": height})
    try:
        pressing(station, WALL)
        for tab, dial in (("start", "#now .dial"), ("jog", "#press .dial")):
            open_tab(page, tab)
            page.locator(dial).get_by_text("in contact").first.wait_for()
            assert violations(page) == [], tab
            if height >= 600:  # a lower page scrolls under its header
                assert page.evaluate("document.documentElement.scrollHeight <= innerHeight"), tab
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})
