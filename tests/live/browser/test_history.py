"""The tab History: tags and stars, deletion with undo, export, and the order of the list."""

import re

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.harness.chromium import open_tab
from tests.harness.serving import Served

HOLD = {"trajectory": {"kind": "hold"}, "duration": 0.5}


def recorded(station: Served) -> str:
    """Record a short run and return its name."""
    station.ready()
    assert station.post("/api/start", HOLD).status_code == 202
    run = station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])["run"]["id"]
    station.rest.delete("/api/operator")
    return run


def open_list(page: Page) -> None:
    """Open the list of runs; the tab itself would show the run again that was open before."""
    page.evaluate("location.hash = '#history'")
    page.locator("#runs .cards").wait_for()


def card(page: Page, run: str) -> Locator:
    return page.locator(f"#runs .card[title='{run}']")


def test_tags_title_and_star_of_a_run_are_kept_and_found(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    card(page, run).click()
    page.get_by_label("tags").fill("coil 2, morning")
    page.get_by_label("title", exact=True).fill("first try")
    page.get_by_role("button", name="Save notes").click()
    page.locator(".note.good", has_text="saved").wait_for()
    page.get_by_role("button", name="☆ star").click()
    page.get_by_role("button", name="★ starred").wait_for()
    page.get_by_role("button", name="all runs").click()
    page.get_by_label("search").fill("MORNING")
    page.get_by_label("which runs").select_option("starred")
    card(page, run).locator("b", has_text="★ first try").wait_for()
    expect(card(page, run).locator(".tag")).to_have_text(["coil 2", "morning"])
    page.get_by_label("search").fill("")
    page.get_by_label("which runs").select_option("")


def test_result_begins_with_what_the_run_was_for(page: Page, station: Served) -> None:
    run = recorded(station)
    answer = station.rest.get(f"/api/runs/{run}").json()
    (case,) = answer["outcomes"].values()
    assert answer["headline"]["number"] == f"{case['largest_distance']:.2f} mm"
    case["stiffness"] = [[235.1, None], [185.2, 346.6]]
    answer["headline"] = {"number": "185 … 347 N/m", "sentence": "estimated stiffness of 4 places, 1 of them unknown"}
    page.route(f"**/api/runs/{run}", lambda route: route.fulfill(json=answer))
    open_list(page)
    card(page, run).click()
    expect(page.locator("#runs .headline")).to_have_text(
        "185 … 347 N/m estimated stiffness of 4 places, 1 of them unknown"
    )
    expect(page.locator("#runs .stiffness-map td")).to_have_text(["235", "\N{EN DASH}", "185", "347"])
    page.get_by_role("button", name="all runs").click()


def test_comparison_of_two_runs_has_a_figure_as_wide_as_a_journals_column(page: Page, station: Served) -> None:
    first, second = recorded(station), recorded(station)
    page.evaluate(f"location.hash = '#history/{first}/{second}'")
    link = page.locator(".figure-links").get_by_role("link", name="SVG").get_attribute("href")
    figure = station.rest.get(str(link))
    assert figure.headers["content-type"].startswith("image/svg+xml")
    width = re.search(r'width="([0-9.]+)pt"', figure.text)
    assert width
    assert float(width[1]) == pytest.approx(88.0 / 25.4 * 72.0, abs=0.01)


def test_headings_of_the_errors_are_above_their_values(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    card(page, run).wait_for()
    for heading, value in zip(
        page.locator(".run-head > button").all(), card(page, run).locator(".number").all(), strict=True
    ):
        above, below = heading.bounding_box(), value.bounding_box()
        assert above is not None
        assert below is not None
        assert above["x"] + above["width"] == pytest.approx(below["x"] + below["width"], abs=1.0)
    for button in ("Compare two", "Delete…"):  # in place before the first tick, and useless without one
        expect(page.locator("#runs").get_by_role("button", name=button)).to_be_disabled()


def test_deleted_run_can_be_restored_by_undo_and_from_the_list(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    box = card(page, run).locator("xpath=..").get_by_role("checkbox")

    def delete() -> None:
        box.check()
        page.locator("#runs").get_by_role("button", name="Delete…").click()
        page.get_by_role("dialog", name="Delete this run?").get_by_role("button", name="Delete").click()
        card(page, run).wait_for(state="detached")

    delete()
    assert station.rest.get(f"/api/runs/{run}").status_code == 404
    page.get_by_role("button", name="Undo").first.click()
    card(page, run).wait_for()
    delete()
    page.get_by_label("which runs").select_option("deleted")
    page.get_by_role("button", name="Restore").first.click()
    page.get_by_label("which runs").select_option("")
    card(page, run).wait_for()
    assert station.rest.get(f"/api/runs/{run}").json()["id"] == run


def test_back_and_links_lead_to_tab_run_and_motion(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    card(page, run).click()
    page.wait_for_url(f"**/#history/{run}")
    open_tab(page, "jog")
    page.go_back()
    page.locator("#runs .result").wait_for()
    page.go_back()
    card(page, run).wait_for()
    page.goto(f"{station.url}/#run/motion/helix")
    page.locator("#start form b", has_text="helix").wait_for()
    page.goto(f"{station.url}/#history/{run}")
    page.locator("#runs .result").wait_for()
    page.reload()
    page.locator("#runs .result").wait_for()
    page.get_by_role("button", name="all runs").click()
    page.wait_for_url("**/#history")


def test_list_is_sorted_by_its_headings_and_says_what_differs_from_the_run_before(page: Page, station: Served) -> None:
    first = recorded(station)
    station.rest.put(f"/api/runs/{first}/notes", json={"title": "zzz"})
    second = recorded(station)
    open_list(page)
    expect(card(page, second).locator(".changed")).not_to_have_text("")
    shown = page.locator("#runs .card.run")
    expect(shown.first).to_have_attribute("title", second)
    heading = page.locator(".run-head").get_by_role("button", name="title")
    heading.click()
    heading.click()  # the other way round
    expect(shown.first).to_have_attribute("title", first)
    page.locator(".run-head").get_by_role("button", name="time").click()
    expect(shown.first).to_have_attribute("title", second)


def test_download_has_the_chosen_numbers_and_rate_and_says_its_size_before(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    card(page, run).click()
    page.locator("summary", has_text="Download as").click()
    size = page.locator(".download [role=status]")
    expect(size).to_have_text(re.compile(r"[0-9]{3} columns, [0-9]+ rows, about .*"))
    page.get_by_role("button", name="None").click()
    page.get_by_role("checkbox", name="tip measured").check()
    page.get_by_label("rows a second").select_option("50 rows/s")
    expect(size).to_have_text(re.compile(r"4 columns, [0-9]{2,3} rows, about [0-9]+ kB"))
    link = page.get_by_role("link", name="Download", exact=True).get_attribute("href")
    header, *rows = station.rest.get(str(link)).text.splitlines()
    assert header == "motion_time [s],tip_measured.x [m],tip_measured.y [m],tip_measured.z [m]"
    times = [float(row.split(",")[0]) for row in rows]
    assert np.diff(times).min() > 0.0199  # more where the loop has missed a period


def test_curves_have_one_cursor_and_a_press_opens_the_replay_at_its_time(page: Page, station: Served) -> None:
    run = recorded(station)
    open_list(page)
    card(page, run).click()
    curves = page.locator("#runs svg.curve.pick")
    curves.nth(1).scroll_into_view_if_needed()
    box = curves.first.bounding_box()
    assert box is not None
    middle = (box["x"] + 0.54 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.move(*middle)
    moments = [
        one.locator(".said").last.inner_text() for one in page.locator("#runs figure:has(svg.pick) figcaption").all()
    ]
    assert moments[0] == moments[1]
    time = float(moments[0].split()[1])
    assert 0.1 < time < 0.4  # of 0.5 s
    page.mouse.click(*middle)
    clock = page.frame_locator("#cover iframe").locator("#clock")
    clock.wait_for()
    assert abs(float(clock.inner_text().split()[0]) - time) < 0.05
    page.get_by_role("button", name="live scene").click()
