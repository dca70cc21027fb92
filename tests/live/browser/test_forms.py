"""Forms: refusals use the units of the fields, and typed text is not lost."""

from playwright.sync_api import Page, expect

from tests.harness.chromium import open_tab, press_until, press_until_sent, wait_until_loaded
from tests.harness.serving import Served


def motion(page: Page, text: str) -> None:
    open_tab(page, "start")
    if page.get_by_role("button", name="all motions").count():
        page.get_by_role("button", name="all motions").click()
    page.locator(".card", has_text=text).click()


def test_refusal_stands_once_below_its_field_in_its_units_with_a_working_value_until_it_is_changed(
    page: Page, station: Served
) -> None:
    assert station.post("/api/goto").status_code == 202  # the suggested period depends on the pose
    station.wait_for(lambda s: s["state"] == "READY" and abs(s["joints"]["inner_translation"] + 0.1) < 1e-4)
    station.rest.delete("/api/operator")
    motion(page, "Move the tip along a circle")
    page.locator("#start").get_by_label("period").fill("4")
    refused = page.locator("#start .refused", has_text="circle cannot be followed")
    for _ in range(2):
        with page.expect_response("**/api/start"):
            press_until_sent(page, page.get_by_role("button", name="Start motion").click)
        refused.filter(has_text="speed of outer_rotation (20 °/s); a period of 8 s would work from here").wait_for()
    expect(refused).to_have_count(1)
    expect(page.locator(".note")).to_have_count(0)
    field = page.locator("#start").get_by_label("period")
    above, below, start = (
        field.bounding_box(),
        refused.bounding_box(),
        page.locator("#start .acts.sticky").bounding_box(),
    )
    assert above is not None
    assert below is not None
    assert start is not None
    assert above["y"] < below["y"] < above["y"] + 60.0  # the next row of the form
    assert below["y"] + below["height"] <= start["y"]  # nothing covers Start
    expect(field).to_have_attribute("aria-invalid", "true")
    field.fill("8")
    expect(refused).to_have_count(0)
    expect(field).not_to_have_attribute("aria-invalid", "true")
    assert station.status()["state"] == "READY"


def test_unsaved_notes_of_a_run_survive_a_page_reload(page: Page, station: Served) -> None:
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 0.5}).status_code == 202
    station.wait_for(lambda status: status["state"] == "READY" and not status["run"]["recording"])

    def open_newest() -> None:
        open_tab(page, "runs")
        notes = page.get_by_label("notes", exact=True)
        # The list is replaced when the newest run arrives, perhaps during the press.
        press_until(page, page.get_by_role("button", name="hold").first.click, notes.is_visible)

    open_newest()
    page.get_by_label("notes", exact=True).fill("a new coil")
    page.reload()
    wait_until_loaded(page)
    open_newest()
    expect(page.get_by_label("notes", exact=True)).to_have_value("a new coil")
    page.get_by_text("not saved yet; kept in this browser").wait_for()
    page.get_by_role("button", name="Save notes").click()
    page.locator(".note", has_text="notes are saved").wait_for()
    expect(page.get_by_text("not saved yet")).to_have_count(0)


def test_page_refuses_to_follow_a_target_that_no_device_measures(page: Page, station: Served) -> None:
    assert station.rest.get("/api/rig").json()["can_track_target"] is False
    motion(page, "Not possible here: no target is measured")
    expect(page.locator("#start form b").first).to_have_text("follow")
    page.locator("#start form", has_text="ctr-station serve --lab breathing").wait_for()
    expect(page.get_by_role("button", name="Start motion")).to_be_disabled()
    page.get_by_role("button", name="all motions").click()


def test_explanations_of_fields_have_the_units_of_the_fields(page: Page) -> None:
    motion(page, "Move the tip along a circle")
    radius = page.locator("#start").get_by_label("radius", exact=True)
    assert "[mm]" in (radius.evaluate("one => one.ariaDescription") or "")
    told = page.locator("#start form label[title], #start form .unit[title]").evaluate_all(
        "all => all.map((one) => one.title)"
    )
    assert len(told) > 20
    assert not [text for text in told if "[m]" in text or "[m/s]" in text or "[rad]" in text]
