"""The tab History: tags and stars, deletion with undo, export, and the order of the list."""

import csv
from pathlib import Path

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


def card(page: Page, run: str) -> Locator:
    return page.locator(f"#runs .card[title='{run}']")


def test_tags_title_and_star_of_a_run_are_kept_and_found(page: Page, station: Served) -> None:
    run = recorded(station)
    open_tab(page, "runs")
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


def test_headings_of_the_errors_are_above_their_values(page: Page, station: Served) -> None:
    run = recorded(station)
    open_tab(page, "runs")
    card(page, run).wait_for()
    for heading, value in zip(
        page.locator(".run-head span").all()[1:], card(page, run).locator(".number").all(), strict=True
    ):
        above, below = heading.bounding_box(), value.bounding_box()
        assert above is not None
        assert below is not None
        assert above["x"] == pytest.approx(below["x"], abs=1.0)
        assert above["width"] == pytest.approx(below["width"], abs=1.0)
    for button in ("Compare two", "Delete…"):  # in place before the first tick, and useless without one
        expect(page.locator("#runs").get_by_role("button", name=button)).to_be_disabled()


def test_deleted_run_can_be_restored_by_undo_and_from_the_list(page: Page, station: Served) -> None:
    run = recorded(station)
    open_tab(page, "runs")
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


def test_csv_of_a_run_has_a_row_for_each_tick(page: Page, station: Served, tmp_path: Path) -> None:
    run = recorded(station)
    open_tab(page, "runs")
    card(page, run).click()
    with page.expect_download() as download:
        page.get_by_role("link", name="CSV").click()
    path = tmp_path / "run.csv"
    download.value.save_as(path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert download.value.suggested_filename == f"{run}-run.csv"
    assert any("tip_measured" in name for name in rows[0])
    assert len({len(row) for row in rows}) == 1
    assert len(rows) > 250  # 0.5 s at 500 Hz
    page.get_by_role("button", name="all runs").click()
