"""The page with its scene: what an operator sees, and drags in it."""

from collections.abc import Callable
from typing import Any

import imageio.v3 as iio
import msgspec
import numpy as np
import viser
from playwright.sync_api import FrameLocator, Page
from websockets.sync.client import connect

from tests.serving import Served
from web.gizmos import FORCE, TARGET
from web.scene import ARROW, UNIT

Picture = Callable[[Page, str], None]

#: The part of a 1280 x 720 page where the robot is: below the header, left of the tabs, right of the legend.
VIEW = {"x": 280, "y": 90, "width": 540, "height": 560}
CIRCLE = {
    "trajectory": {"kind": "circle", "radius": 0.003, "period": 12.0, "normal": [0, 0, 1]},
    "controller": {"strategy": "dual_layer", "feedforward": True},
    "duration": 60.0,
}


def scene(page: Page) -> FrameLocator:
    return page.frame_locator("#scene")


def pixels(page: Page) -> np.ndarray:
    return iio.imread(page.screenshot(clip=VIEW)).astype(float)[..., :3]


def changed(before: np.ndarray, after: np.ndarray) -> int:
    return int((np.abs(after - before).max(axis=-1) > 40).sum())


def state(page: Page) -> str:
    return page.locator("#state").inner_text()


def test_the_page_says_the_state_and_every_device_answers(page: Page, picture: Picture) -> None:
    assert state(page) == "READY"
    assert page.locator("#says").inner_text() == "nothing moves"
    lights = page.locator("#lights li")
    assert lights.all_inner_texts() == ["stages", "tracker", "force sensors"]
    assert [light.get_attribute("data-severity") for light in page.locator("#lights .light").all()] == ["0"] * 3
    assert "nothing is wrong" in str(lights.first.get_attribute("title"))
    assert "µs" in page.locator("#loop").inner_text()
    picture(page, "panel")


def test_the_scene_shows_units_and_a_legend(page: Page) -> None:
    text = scene(page).locator("body").inner_text()
    for name in ("desired tip", "measured tip", "estimated tip", "100 mm for 1 N"):
        assert name in text


def test_the_robot_moves_in_pixels_and_in_numbers(page: Page, station: Served, picture: Picture) -> None:
    # What changes by itself: trackers are noisy, texts are refreshed. The quietest of three looks counts.
    noise = []
    for _ in range(3):
        still = pixels(page)
        page.wait_for_timeout(500)
        noise.append(changed(still, pixels(page)))
    assert station.post("/api/start", CIRCLE).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving", 10.0)
    before = np.array(station.status()["tip_true"])
    first = pixels(page)
    page.wait_for_timeout(5000)
    after = np.array(station.status()["tip_true"])
    assert 1e3 * np.linalg.norm(after - before) > 5.0
    assert changed(first, pixels(page)) > 300 + 2 * min(noise)
    assert state(page) == "RUNNING"
    assert "left of 1:00" in page.locator("#run-left").inner_text()
    picture(page, "running")


def test_the_header_stops_the_robot_and_reset_makes_it_ready(page: Page, station: Served) -> None:
    station.post("/api/start", CIRCLE)
    station.rest.delete("/api/operator")
    page.locator("#state", has_text="RUNNING").wait_for(timeout=5000)
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for(timeout=5000)
    assert station.status()["state"] == "STOPPED"
    assert "operator" in page.locator("#says").inner_text()
    page.locator("#reset").click()
    page.locator("#state", has_text="READY").wait_for(timeout=5000)


def test_shift_space_stops_with_the_focus_on_the_page_and_in_the_scene(page: Page, station: Served) -> None:
    for x, y in ((600, 30), (450, 600)):  # the header; the floor in the scene
        station.ready()
        station.post("/api/start", CIRCLE)
        page.locator("#state", has_text="RUNNING").wait_for(timeout=5000)
        page.mouse.click(x, y)
        page.keyboard.press("Shift+Space")
        page.locator("#state", has_text="STOPPED").wait_for(timeout=5000)


def test_a_view_is_chosen(page: Page) -> None:
    before = pixels(page)
    scene(page).get_by_text("View", exact=True).click()
    scene(page).get_by_role("button", name="Tip").click()
    page.wait_for_timeout(2500)
    assert changed(before, pixels(page)) > 5000
    scene(page).get_by_role("button", name="Overview").click()
    scene(page).get_by_text("Legend", exact=True).click()
    page.wait_for_timeout(2500)


def test_workspace_ghost_and_uncertainty_are_shown_on_demand(page: Page, station: Served, picture: Picture) -> None:
    for name in ("workspace", "ghost", "uncertainty"):
        before = pixels(page)
        box = page.locator(f"#switches input[name={name}]")
        with page.expect_response("**/api/scene"):
            box.check()
        assert station.rest.get("/api/scene").json()[name]
        page.wait_for_timeout(2500)
        if name == "workspace":
            assert changed(before, pixels(page)) > 3000
            picture(page, "workspace")
        with page.expect_response("**/api/scene"):
            box.uncheck()


# ---- dragging: the messages of a browser that drags, sent by the page's own identity


def drag(page: Page, station: Served, name: str, place: np.ndarray) -> None:
    """What viser's client sends when a handle is dragged to a place (3,) [m]."""
    client = page.evaluate("() => sessionStorage.getItem('client')")
    address = f"ws://127.0.0.1:{station.port}/viser/as/{client}"
    common: dict[str, Any] = {"name": name, "owner": ""}
    with connect(address, subprotocols=[f"viser-v{viser.__version__}"], proxy=None, max_size=None) as socket:
        for message in (
            {"type": "TransformControlsDragStartMessage", **common},
            {
                "type": "TransformControlsUpdateMessage", "wxyz": [1.0, 0.0, 0.0, 0.0],
                "position": (UNIT * place).tolist(), **common,
            },
            {"type": "TransformControlsDragEndMessage", **common},
        ):  # fmt: skip
            socket.send(msgspec.msgpack.encode(message))
        page.wait_for_timeout(1000)


def test_a_target_is_dragged_judged_and_gone_to(page: Page, station: Served, picture: Picture) -> None:
    box = page.locator("#switches input[name=target]")
    with page.expect_response("**/api/scene"):
        box.check()
    try:
        tip = np.array(station.status()["tip_true"])
        drag(page, station, TARGET, tip + np.array((0.0, 0.0, 0.2)))
        page.locator("#target-says", has_text="✗").wait_for(timeout=5000)
        assert page.locator("#go").is_disabled()
        goal = tip + np.array((0.008, 0.0, -0.004))
        drag(page, station, TARGET, goal)
        page.locator("#target-says", has_text="✓").wait_for(timeout=5000)
        picture(page, "target")
        page.locator("#go").click()
        station.wait_for(lambda s: s["state"] == "RUNNING", 10.0)
        station.wait_for(lambda s: s["state"] == "READY", 40.0)
        assert 1e3 * np.linalg.norm(np.array(station.status()["tip_true"]) - goal) < 1.0
    finally:
        box.uncheck()


def test_a_hand_pulls_at_the_tip(page: Page, station: Served, picture: Picture) -> None:
    box = page.locator("#switches input[name=force]")
    with page.expect_response("**/api/scene"):
        box.check()
    try:
        tip = np.array(station.status()["tip_true"])
        drag(page, station, FORCE, tip + ARROW * np.array((0.3, 0.0, 0.0)))
        status = station.wait_for(lambda s: s["force"][0] > 0.2, 5.0)
        assert abs(status["force"][0] - 0.3) < 0.15
        assert 1e3 * (status["tip_true"][0] - tip[0]) > 3.0  # it gives way
        picture(page, "hand")
    finally:
        box.uncheck()
    station.wait_for(lambda s: abs(s["force"][0]) < 0.1, 5.0)
