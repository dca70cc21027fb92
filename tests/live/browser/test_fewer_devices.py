"""Benches without a tracker or force sensors from the page: from homing to the report."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from station.config.strict import PRESETS
from tests.harness.chromium import bare_page, open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served, serving

NOTES = {
    ("sensors",): "no force sensors: the force is estimated",
    ("tracker",): "but no tracker: the loaded model computes the tip",
    ("tracker", "sensors"): "stages alone",
}
LIGHTS = {"stages": "stages", "tracker": "tracker", "sensors": "force sensors"}
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


@pytest.mark.parametrize("missing", NOTES)
def test_page_leads_a_smaller_bench_from_homing_to_the_report(
    browser: Browser, missing: tuple[str, ...], robot: Path
) -> None:
    homes = len(missing) == 2  # the stages home in the same way on every bench
    near_home = ("--robot", str(robot)) if homes else ()
    with serving(*(text for kind in missing for text in ("--without", kind)), *near_home) as station:
        station.wait_for(lambda s: s["state"] == "READY" and not s["stale"])
        with bare_page(browser, station) as page:
            for kind, name in LIGHTS.items():
                named = page.locator("#lights", has_text=name)
                expect(named).to_have_count(int(kind not in missing))
            open_tab(page, "devices")
            page.locator("#devices", has_text=NOTES[missing]).wait_for()
            zero = page.get_by_role("button", name="Zero the force sensors")
            expect(zero).to_be_visible(visible="sensors" not in missing)
            if homes:
                home(page, station)
            circle(page, station)
            page.locator("#ended").get_by_role("button", name="Result").click()
            page.get_by_role("button", name="Report", exact=True).click()
            report = page.frame_locator("#cover iframe")
            report.locator("h1").first.wait_for()
            report.locator("body", has_text="simulated").wait_for()
            page.get_by_role("button", name="live scene").click()
            open_tab(page, "calibrate")
            page.locator("#calibrate .card", has_text="Force sensors").wait_for()
            expect(page.locator("#calibrate .card", has_text="Force sensors")).to_be_enabled(enabled=not missing)
            expect(page.locator("#calibrate .card", has_text="Latency")).to_be_enabled(enabled="tracker" not in missing)
