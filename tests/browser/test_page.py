"""What an operator sees and presses."""

import imageio.v3 as iio
import numpy as np
from playwright.sync_api import FrameLocator, Page

from tests.serving import Served

#: The part of a 1280 x 720 page where the robot is: below the header, left of the panel.
VIEW = {"x": 0, "y": 70, "width": 880, "height": 640}
CIRCLE = {
    "trajectory": {"kind": "circle", "radius": 0.003, "period": 12.0, "normal": [0, 0, 1]},
    "controller": {"strategy": "dual_layer", "feedforward": True},
    "duration": 60.0,
}


def scene(page: Page) -> FrameLocator:
    return page.frame_locator("#scene")


def picture(page: Page) -> np.ndarray:
    return iio.imread(page.screenshot(clip=VIEW)).astype(float)[..., :3]


def changed(before: np.ndarray, after: np.ndarray) -> int:
    return int((np.abs(after - before).max(axis=-1) > 40).sum())


def state(page: Page) -> str:
    return page.locator("#state").inner_text()


def test_the_page_says_the_state_and_every_device_answers(page: Page) -> None:
    assert state(page) == "READY"
    lights = page.locator("#lights")
    assert lights.inner_text().split("\n") == ["stages", "tracker", "force sensors"]
    assert lights.locator("i.bad").count() == 0
    assert "µs" in page.locator("#loop").inner_text()


def test_the_scene_shows_units_and_a_legend(page: Page) -> None:
    text = scene(page).locator("body").inner_text()
    assert "[mm]" in text
    assert "[N]" in text
    for name in ("desired tip", "measured tip", "estimated tip"):
        assert name in text


def test_the_robot_moves_in_pixels_and_in_numbers(page: Page, station: Served) -> None:
    # What changes by itself: trackers are noisy, texts are refreshed. The quietest of three looks counts.
    noise = []
    for _ in range(3):
        still = picture(page)
        page.wait_for_timeout(500)
        noise.append(changed(still, picture(page)))
    assert station.post("/api/start", CIRCLE).status_code == 202
    station.wait_for(lambda s: s["run"]["phase"] == "moving", 10.0)
    before = np.array(station.status()["tip_true"])
    first = picture(page)
    page.wait_for_timeout(5000)
    after = np.array(station.status()["tip_true"])
    assert 1e3 * np.linalg.norm(after - before) > 5.0
    assert changed(first, picture(page)) > 300 + 2 * min(noise)
    assert state(page) == "RUNNING"
    assert "left" in page.locator("#run-left").inner_text()


def test_the_header_stops_the_robot_and_reset_makes_it_ready(page: Page, station: Served) -> None:
    station.post("/api/start", CIRCLE)
    page.locator("#state", has_text="RUNNING").wait_for(timeout=2000)
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for(timeout=1000)
    assert station.status()["state"] == "STOPPED"
    assert "operator" in page.locator("#cause").inner_text()
    page.locator("#reset").click()
    page.locator("#state", has_text="READY").wait_for(timeout=2000)


def test_shift_space_stops_with_the_focus_on_the_page_and_in_the_scene(page: Page, station: Served) -> None:
    for x, y in ((300, 30), (450, 600)):  # the header; the floor in the scene
        station.ready()
        station.post("/api/start", CIRCLE)
        page.locator("#state", has_text="RUNNING").wait_for(timeout=2000)
        page.mouse.click(x, y)
        page.keyboard.press("Shift+Space")
        page.locator("#state", has_text="STOPPED").wait_for(timeout=2000)


def test_start_and_stop_in_the_panel(page: Page, station: Served) -> None:
    scene(page).get_by_text("Start experiment").click()
    station.wait_for(lambda s: s["state"] == "RUNNING", 5.0)
    page.locator("#state", has_text="RUNNING").wait_for(timeout=2000)
    assert ", case " in page.locator("#run-title").inner_text()
    scene(page).get_by_role("button", name="STOP").click()
    station.wait_for(lambda s: s["state"] == "STOPPED", 2.0)
    page.locator("#state", has_text="STOPPED").wait_for(timeout=2000)
