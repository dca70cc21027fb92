"""A bench with stages alone, operated on the page from homing to the report; the page's texts on other benches."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from station.config.strict import PRESETS
from tests.harness.chromium import bare_page, open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served, serving

#: Devices in addition to the stages, and a part of the page's note about this bench.
NOTES = {
    ("tracker",): "no force sensors: the force is estimated",
    ("sensors",): "but no tracker: the loaded model computes the tip",
    (): "stages alone",
}
#: Working poses of the preset robot and of a robot that starts near its home sensors, so that homing takes seconds and
#: not a minute [rad, m].
USUAL_POSE = "inner_rotation = 1.5707963267948966, inner_translation = -0.100"
NEAR_HOME = {"inner_rotation": 0.4, "inner_translation": -0.115}


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """File of the robot whose working pose is near its home sensors."""
    text = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")
    pose = ", ".join(f"{joint} = {value}" for joint, value in NEAR_HOME.items())
    assert USUAL_POSE in text
    path = tmp_path / "near_home.toml"
    path.write_text(text.replace(USUAL_POSE, pose), encoding="utf-8")
    return path


def home(page: Page, station: Served) -> None:
    """Home the stages, which the page offers only after the path is confirmed clear, and reach the working pose."""
    button = page.locator("#devices").get_by_role("button", name="Home…")
    dialog = press_until_asked(page, button.click)
    dialog.get_by_role("checkbox").check()
    dialog.get_by_role("button", name="Home", exact=True).click()
    page.locator("#state", has_text="HOMING").wait_for()
    expect(button).to_be_disabled()
    page.locator("#state", has_text="READY").wait_for()
    joints = station.wait_for(lambda s: s["state"] == "READY")["joints"]
    assert {name: joints[name] for name in NEAR_HOME} == pytest.approx(NEAR_HOME, abs=1e-3)


def circle(page: Page, station: Served) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="Move the tip along a circle").click()
    page.locator("#start").get_by_label("radius").fill("2")
    page.locator("#start").get_by_label("period").fill("8")
    page.locator("#start").get_by_label("duration").fill("2")
    before = station.status()["run"]
    press_until_sent(page, page.get_by_role("button", name="Start motion").click)
    # The motion is short, so a busy computer may miss it.
    station.wait_for(lambda s: s["run"] is not None and (before is None or s["run"]["id"] != before["id"]))
    station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])


#: Script that returns the note of a bench with these devices.
NOTE = "(devices) => import('/static/page/station.js').then(({ benchNote }) => benchNote(devices))"
#: Script that returns the text below the force from the deflection for variances of its axes [N²].
POSSIBLE = """(force_variance) => import('/static/page/strip.js').then(({ possibleForce }) => possibleForce(
    { deflection_filtered: null, force_filtered: [0.4, 0.4, 0.1], force_possible: 0.84, force_variance }))"""


def test_page_leads_a_bench_with_stages_alone_from_its_start_to_the_report(browser: Browser, robot: Path) -> None:
    alone = ("--without", "tracker", "--without", "sensors", "--robot", str(robot))
    # The page is opened while the devices are connected.
    with serving(*alone, connected=False) as station, bare_page(browser, station) as page:
        expect(page.locator("#lights li")).to_have_count(1)
        for kinds, text in NOTES.items():
            assert text in page.evaluate(NOTE, {kind: {} for kind in ("stages", *kinds)})
        open_tab(page, "devices")
        page.locator("#devices", has_text=NOTES[()]).wait_for()
        expect(page.get_by_role("button", name="Zero the force sensors")).to_be_hidden()
        assert page.evaluate(POSSIBLE, [1e-4, 1e-4, 1e-4]) == "up to\u00a00.84\u00a0N"
        assert page.evaluate(POSSIBLE, [1e-4, 1e-4, 9.0]) == "z\u00a0unknown"
        home(page, station)
        circle(page, station)
        page.locator("#ended").get_by_role("button", name="Result").click()
        page.get_by_role("button", name="Report", exact=True).click()
        report = page.frame_locator("#cover iframe")
        report.locator("h1").first.wait_for()
        report.locator("body", has_text="simulated").wait_for()
        page.get_by_role("button", name="live scene").click()
        open_tab(page, "calibrate")
        for procedure in ("Force sensors", "Latency"):
            expect(page.locator("#calibrate .card", has_text=procedure)).to_be_disabled()
