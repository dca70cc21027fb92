"""Messages of the page: complete texts, a button for the next action, and a report of lost control."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from tests.harness.chromium import SIZE, open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served


@pytest.fixture
def says(station: Served, page: Page) -> Iterator[Callable[..., None]]:
    """Replace fields of the status: `says(state="FAULT", action="reset")`; `says()` restores the true status."""
    changes: dict[str, Any] = {}
    before = station.status()

    def change(**some: Any) -> None:
        changes.clear()
        changes.update(some)

    def answer(route: Route) -> None:
        if changes:
            route.fulfill(json=before | changes)
        else:
            route.continue_()

    page.route("**/api/status", answer)
    yield change
    page.unroute("**/api/status")


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (390, 844)])
def test_long_fault_message_is_shown_completely(page: Page, says: Callable[..., None], width: int, height: int) -> None:
    axes = [f"axis {n} cannot be reached (2 replies are missing); last seen at 1{n}.0 deg" for n in range(6)]
    says(state="FAULT", message="; ".join(axes), next="find the cause, then Reset", action="reset")
    page.set_viewport_size({"width": width, "height": height})
    try:
        text = page.locator("#says")
        page.locator("#state", has_text="FAULT").wait_for()
        expect(text).to_have_text("; ".join(axes))
        assert text.evaluate("box => box.scrollHeight <= box.clientHeight + 1")
        expect(page.locator("#reset")).to_be_visible()
        expect(page.locator("#tab-bench")).to_be_visible()
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})


@pytest.mark.parametrize(
    ("width", "height", "hint"),
    [
        (1280, 720, "choose an experiment on the right"),
        (390, 844, "choose an experiment below"),
        (720, 450, "choose an experiment below"),  # 200 % zoom
    ],
)
def test_hint_of_a_ready_station_names_what_is_visible_and_is_not_cut(
    page: Page, width: int, height: int, hint: str
) -> None:
    page.set_viewport_size({"width": width, "height": height})
    try:
        open_tab(page, "start")
        message = page.locator("#message")
        expect(page.locator("#next")).to_have_text(hint)
        assert message.evaluate("b => b.scrollWidth <= b.clientWidth && b.scrollHeight <= b.clientHeight + 1")
        page.locator(".card", has_text="Keep the tip where it is").click()
        expect(page.locator("#next")).to_have_text("press Start motion")
        expect(page.get_by_role("button", name="Start motion")).to_be_in_viewport()
        page.get_by_role("button", name="all motions").click()
        open_tab(page, "plots")
        expect(message).to_have_text(re.compile("tab Run$" if width > 900 else "^nothing moves$"))
        expect(page.locator("#act").get_by_role("button", name="Choose a motion")).to_be_visible()
    finally:
        page.set_viewport_size(SIZE)


def test_page_shows_a_button_for_the_next_action_next_to_every_message(page: Page, says: Callable[..., None]) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="Keep the tip where it is").click()
    says(state="CONNECTED", message="devices answer", next="home the stages", action="home")
    places = (
        ("start", "#start .sticky"), ("jog", "#jog > p"), ("jog", "#hands"), ("faults", "#faults"), ("plots", "#act"),
    )  # fmt: skip
    for tab, place in places:
        open_tab(page, tab)
        press_until_asked(page, page.locator(place).get_by_role("button", name="Home…").click)
        page.get_by_role("dialog", name="Home every stage?").get_by_role("button", name="Cancel").click()
    says(state="OFF", message="no device is spoken to", next="connect the devices", action="connect")
    page.locator("#act").get_by_role("button", name="Connect").wait_for()
    says()
    choose = page.locator("#act").get_by_role("button", name="Choose a motion")
    expect(choose).to_have_class("main")
    open_tab(page, "jog")
    expect(choose).to_have_class("")  # a jog is what the user came for
    choose.click()
    expect(page.locator("#start")).to_be_visible()
    page.get_by_role("button", name="all motions").click()


def test_refusal_on_the_page_shows_the_button_that_resolves_it(
    station: Served, page: Page, says: Callable[..., None]
) -> None:
    says(state="READY", action="start")
    station.post("/api/stop")
    station.rest.delete("/api/operator")

    def learn(route: Route) -> None:
        says()
        route.continue_()

    page.route("**/api/tare", learn)
    open_tab(page, "devices")
    press_until_sent(page, page.get_by_role("button", name="Zero the force sensors").click, "/api/tare")
    note = page.locator(".note", has_text="'tare' is not possible while STOPPED")
    note.get_by_role("button", name="Reset").click()
    page.locator("#state", has_text="READY").wait_for()
    note.wait_for(state="detached")
    page.unroute("**/api/tare")


def test_page_reload_keeps_the_tab_and_the_plots_history(station: Served, page: Page) -> None:
    module = "import('/static/page/telemetry.js')"
    first = f"{module}.then((telemetry) => telemetry.samples[0]?.time ?? null)"
    open_tab(page, "plots")
    # The page stores a few minutes only: the first sample must not be older.
    page.evaluate(f"{module}.then(({{samples}}) => samples.splice(0, samples.length - 1).length)")
    page.wait_for_function(f"() => {first}")
    before = page.evaluate(first)
    page.reload()
    page.locator("#state", has_text="READY").wait_for()
    expect(page.locator("#plots")).to_be_visible()
    assert page.evaluate(first) == pytest.approx(before, abs=1e-6)
    page.wait_for_function(
        f"() => import('/static/page/telemetry.js').then(({{samples}}) => samples.at(-1).time > {before} + 1)"
    )


def test_page_reports_the_loss_of_control_to_another_client(station: Served, page: Page) -> None:
    page.locator("#operator", has_text="No operator").wait_for()
    press_until_asked(page, page.get_by_role("button", name="Take control").click)
    page.get_by_label("your name").fill("Anna")
    page.get_by_role("dialog").get_by_role("button", name="Take control").click()
    page.locator("#operator", has_text="You are operator").wait_for()
    station.rest.post("/api/operator", json={"name": "Ben", "take_over": True})
    note = page.locator(".note", has_text="'Ben' has taken control")
    note.get_by_role("button", name="Take over…").click()
    page.get_by_role("dialog").get_by_role("button", name="Take over").click()
    page.locator("#operator", has_text="You are operator").wait_for()
    page.get_by_role("button", name="Release").click()
    page.locator("#operator", has_text="No operator").wait_for()
    # No message appears if the operator has released the lease.
    assert not any("operator" in text or "control" in text for text in page.locator(".note").all_inner_texts())


#: Internal words, which no text of the page may have outside of code: keys, representations of Python, and SI units of
#: lengths and angles, which the page shows in millimetres and degrees.
INTERNAL = re.compile(
    r"[A-Za-z]\w*_\w+|\w+=[('\[\d]|\b(?:None|True|False|undefined|NaN)\b|\[(?:rad|m|m/s|rad/s)\]|<\w+ object|\[object"
)
#: Terms of the operating system with an underscore.
TERMS = {"SCHED_FIFO", "SCHED_OTHER"}
TEXTS = """() => {
  const found = [], all = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (all.nextNode()) {
    if (all.currentNode.parentElement.closest("code, script, style") === null) found.push(all.currentNode.data);
  }
  for (const one of document.querySelectorAll("body :not(code)"))
    for (const name of ["title", "aria-label", "aria-description"]) found.push(one.getAttribute(name) ?? "");
  return found;
}"""


def internal_words(page: Page) -> set[str]:
    """Return the internal words of every text and explanation of the page, of hidden parts too, with their texts."""
    return {
        f"{word}: {text.strip()[:120]}"
        for text in page.evaluate(TEXTS)
        for word in INTERNAL.findall(text)
        if word not in TERMS
    }


def test_no_text_of_the_page_has_an_internal_word(page: Page, says: Callable[..., None]) -> None:
    found: set[str] = set()
    for tab in ("jog", "plots", "runs", "devices", "faults"):
        open_tab(page, tab)
        found |= internal_words(page)
    for tab, head in (("calibrate", "all procedures"), ("start", "all motions")):
        open_tab(page, tab)
        cards = page.locator(f"#{tab} .card:not([disabled])")
        cards.last.wait_for()
        for number in range(cards.count()):
            cards.nth(number).click()
            page.get_by_role("button", name=head).wait_for()
            found |= internal_words(page)
            page.get_by_role("button", name=head).click()
            cards.last.wait_for()
    for state in ("OFF", "CONNECTING", "CONNECTED", "HOMING", "HOMED", "READY", "RUNNING", "HOLD", "STOPPED", "FAULT"):
        says(state=state, joints={}, tip_measured=None, tip_estimated=None)
        page.locator("#state", has_text=state).wait_for()
        found |= internal_words(page)
    assert found == set()


#: Reasons of disabled buttons that do not depend on the state or the operator.
OWN_REASONS = r"Nothing to undo|Tick two runs|Tick the runs to delete|This waypoint is the|No run is in progress"
DISABLED = """() => [...document.querySelectorAll("button:disabled")].filter((one) => one.checkVisibility())
  .map((one) => [one.textContent, one.title])"""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"state": "HOLD", "action": "reset"}, "Possible while .*, not while HOLD"),
        ({"state": "RUNNING", "action": "", "phase": "moving"}, "Possible while .*, not while RUNNING"),
        ({"state": "CONNECTED", "action": "home"}, "Possible while .*, not while CONNECTED"),
        ({"operator": {"name": "Eve", "you": False, "role": "operator", "lapses_s": 9.0}}, "'Eve' is operator"),
        ({"operator": {"name": None, "you": False, "role": "viewer", "lapses_s": None}}, "A viewer may only view"),
    ],
)
def test_every_disabled_button_has_its_reason(
    page: Page, says: Callable[..., None], changes: dict[str, Any], reason: str
) -> None:
    counted = 0
    says(**changes)
    try:
        for tab in ("start", "jog", "plots", "runs", "cameras", "devices", "calibrate", "faults"):
            open_tab(page, tab)
            if tab == "start":
                page.locator(".card", has_text="Keep the tip where it is").click()
            # The page's data may be old for a moment on a busy computer; then this is the reason.
            page.locator("body:not(.stale)").wait_for()
            for text, title in page.evaluate(DISABLED):
                assert re.match(f"{reason}|{OWN_REASONS}|The page has no current data", title), (tab, text, title)
                counted += re.match(reason, title) is not None
            if tab == "start":
                page.get_by_role("button", name="all motions").click()
        assert counted >= 5  # among them Start and the buttons of the tab Jog
    finally:
        says()
