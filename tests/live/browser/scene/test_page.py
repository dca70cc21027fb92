"""The page with its scene: displayed contents and draggable handles."""

import re
from collections.abc import Callable
from typing import Any

import imageio.v3 as iio
import numpy as np
from playwright.sync_api import FrameLocator, Page, Response, expect

from station.config.palette import CONTACT
from station.config.robots import load_robot
from tests.harness.chromium import open_tab
from tests.harness.serving import Served
from tests.harness.waiting import until
from web.scene.cameras import FIELD_OF_VIEW_RAD, camera, extent
from web.scene.gizmos import FORCE_SIZE_M, TARGET_SIZE_M
from web.scene.scene import ARROW_SCALE_M_PER_N

Picture = Callable[[Page, str], None]

#: Rectangle of a 1280 x 720 page that shows the robot: below the views, left of the close-up of the tip [pixels].
VIEW = {"x": 10, "y": 140, "width": 520, "height": 480}
CIRCLE = {
    "trajectory": {"kind": "circle", "radius": 0.003, "period": 12.0, "normal": [0, 0, 1]},
    "controller": {"strategy": "dual_layer", "feedforward": True},
    "duration": 60.0,
}
HOLD = {
    "trajectory": {"kind": "hold"},
    "controller": {"strategy": "dual_layer", "inner": "type_2", "feedback": "observer", "feedforward": True},
    "duration": 60.0,
}


def scene(page: Page) -> FrameLocator:
    return page.frame_locator("#scene")


def pixels(page: Page) -> np.ndarray:
    return iio.imread(page.screenshot(clip=VIEW, scale="css")).astype(float)[..., :3]


def changed(before: np.ndarray, after: np.ndarray) -> int:
    return int((np.abs(after - before).max(axis=-1) > 40).sum())


def state(page: Page) -> str:
    return page.locator("#state").inner_text()


def test_page_shows_the_station_state_and_every_device(page: Page) -> None:
    page.locator("#state", has_text="READY").wait_for()
    page.locator("#says", has_text="nothing moves").wait_for()
    lights = page.locator("#lights li")
    page.locator("#lights:not(:has(.light:not([data-severity='0'])))").wait_for()
    names = [light.inner_text().partition(":")[0].strip() for light in lights.all()]
    assert names == ["stages", "tracker", "force sensors"]
    expect(page.locator("#lights .light[data-severity='0']")).to_have_count(3)
    expect(lights.first).to_have_attribute("title", re.compile("nothing is wrong"))
    expect(page.locator("#loop")).to_contain_text("500 Hz")
    expect(page.locator("#loop")).to_have_attribute("title", re.compile("µs"))


def test_scene_has_a_legend_with_units(page: Page) -> None:
    page.locator("#legend summary").click()
    text = page.locator("#legend").inner_text()
    page.locator("#legend summary").click()
    for name in ("desired tip", "measured tip", "estimated tip", "100 mm for 1 N"):
        assert name in text


def test_running_robot_moves_in_the_scene_and_in_the_status(page: Page, station: Served, picture: Picture) -> None:
    def median() -> np.ndarray:
        """Return the median of five pictures, which removes the flicker by the noise of tracker and force sensors."""
        return np.median([pixels(page) for _ in range(5)], axis=0)

    def tip() -> np.ndarray:
        return np.array(station.status()["tip_true"])

    assert station.post("/api/start", CIRCLE).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving")
    expect(page.locator("#run-left")).to_contain_text("left of 1:00")
    assert state(page) == "RUNNING"
    page.wait_for_timeout(2500)  # the camera moves to the motion
    first, start = pixels(page), tip()
    until(lambda: 1e3 * np.linalg.norm(tip() - start) > 4.0)
    moved = changed(first, pixels(page))
    picture(page, "running")
    station.post("/api/stop")
    page.locator("#state", has_text="STOPPED").wait_for()
    until(lambda: 4 * changed(median(), median()) < moved)


def test_shift_space_stops_with_the_focus_on_the_page_and_in_the_scene(page: Page, station: Served) -> None:
    for x, y in ((600, 30), (450, 600)):  # a position in the header and one on the floor of the scene
        station.ready()
        station.post("/api/start", CIRCLE)
        page.locator("#state", has_text="RUNNING").wait_for()
        page.mouse.click(x, y)
        page.keyboard.press("Shift+Space")
        page.locator("#state", has_text="STOPPED").wait_for()


def test_view_button_moves_the_camera_of_the_scene(page: Page) -> None:
    before = pixels(page)
    page.locator("#views button", has_text="Tip").click()
    until(lambda: changed(before, pixels(page)) > 5000)
    page.locator("#views button", has_text="Overview").click()
    page.wait_for_timeout(2500)


def _chosen(response: Response) -> bool:
    """Return whether a response answers a changed switch and not a poll; the page also polls this path."""
    return response.url.endswith("/api/scene") and response.request.method == "PUT"


def test_scene_shows_workspace_unloaded_shape_and_uncertainty_on_demand(
    page: Page, station: Served, picture: Picture
) -> None:
    for name in ("workspace", "ghost", "uncertainty"):
        before = pixels(page)
        box = page.locator(f"#switches input[name={name}]")
        with page.expect_response(_chosen):
            box.check()
        assert station.rest.get("/api/scene").json()[name]
        if name == "workspace":
            until(lambda before=before: changed(before, pixels(page)) > 3000)
            picture(page, "workspace")
        with page.expect_response(_chosen):
            box.uncheck()


# ---- dragging, with the mouse


def on_screen(page: Page, place: np.ndarray) -> np.ndarray:
    """Return the pixel of the page where the initial camera draws a position (3,) [m]."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    robot = load_robot("paper")
    room = extent(robot.robot(), robot.limits())
    eye, centre, _ = camera("Overview", room, room.middle, box["width"] / box["height"])
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(ahead, (-1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    seen = place - eye
    scale = 0.5 * box["height"] / (np.tan(0.5 * FIELD_OF_VIEW_RAD) * (seen @ ahead))
    middle = np.array((box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]))
    return middle + scale * np.array((seen @ right, -seen @ np.cross(right, ahead)))


def drag(page: Page, handle: np.ndarray, size: float, axis: int, way: float) -> None:
    """Drag a handle at a position (3,) [m] by the arrow of one axis, `size` long [m], by a distance [m]."""
    arrow = np.zeros(3)
    arrow[axis] = 1.0
    grip = handle + 0.75 * size * arrow  # the inner part of the arrow is covered by the handles of the planes
    page.mouse.move(*on_screen(page, grip))
    page.wait_for_timeout(500)  # software rendering needs time until the arrow reacts to the pointer
    page.mouse.down()
    for part in np.linspace(0.0, 1.0, 9)[1:]:
        page.mouse.move(*on_screen(page, grip + part * way * arrow))
        page.wait_for_timeout(60)
    page.wait_for_timeout(300)
    page.mouse.up()


def drag_until(page: Page, attempt: Callable[[], None], moved: Callable[[], bool]) -> None:
    """Drag until a handle has moved, each time from the view for which `on_screen` computes pixels.

    If a busy computer has not yet drawn the handle under the pointer, the drag turns the camera instead.
    """
    for _ in range(20):
        page.locator("#views button", has_text="Overview").click()
        page.wait_for_timeout(2500)
        attempt()
        page.wait_for_timeout(1000)
        if moved():
            return
    raise AssertionError("no handle has moved")


def target(station: Served) -> dict[str, Any]:
    return station.rest.get("/api/scene/target").json()


def drag_target(page: Page, station: Served, axis: int, to: float, within: float) -> None:
    """Drag the target along one axis to a coordinate [m], within a distance [m].

    A busy computer may draw, and so drag, only a part of the way: the next drag goes the rest.
    """

    def rest() -> float:
        return to - target(station)["position"][axis]

    drag_until(
        page,
        lambda: drag(page, np.array(target(station)["position"]), TARGET_SIZE_M, axis, rest()),
        lambda: abs(rest()) < within,
    )


def test_target_handle_is_dragged_and_checked_and_the_tip_reaches_it(
    page: Page, station: Served, picture: Picture
) -> None:
    box = page.locator("#switches input[name=target]")
    page.get_by_label("fold the close-up").click()  # the close-up lies over the place to which the handle is dragged
    with page.expect_response(_chosen):
        box.check()
    try:
        page.wait_for_timeout(1500)
        tip = np.array(target(station)["position"])
        drag_target(page, station, 0, tip[0] - 0.13, 0.02)
        page.locator("#target-says", has_text="✗").wait_for()
        expect(page.locator("#go")).to_be_disabled()
        far = np.array(target(station)["position"])
        assert far[0] - tip[0] < -0.1
        assert np.abs(far - tip)[1:].max() < 1e-6
        drag_target(page, station, 0, tip[0] + 0.008, 0.003)
        drag_target(page, station, 2, tip[2] - 0.004, 0.002)
        page.locator("#target-says", has_text="✓").wait_for()
        goal = np.array(target(station)["position"])
        assert goal[0] - tip[0] > 0.004
        picture(page, "target")
        page.locator("#go").click()
        station.wait_for(lambda s: s["state"] == "RUNNING")
        station.wait_for(lambda s: s["state"] == "READY")
        assert 1e3 * np.linalg.norm(np.array(station.status()["tip_true"]) - goal) < 1.0
    finally:
        box.uncheck()
        page.get_by_label("show the close-up").click()


def test_controller_compensates_a_pull_at_the_tip(page: Page, station: Served, picture: Picture) -> None:
    assert station.post("/api/start", HOLD).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving")
    station.rest.delete("/api/operator")
    box = page.locator("#switches input[name=force]")
    with page.expect_response(_chosen):
        box.check()
    try:
        page.wait_for_timeout(1500)
        before = station.status()

        def mean_force() -> np.ndarray:
            return np.mean([station.status()["force"] for _ in range(40)], axis=0)

        def pull() -> None:
            # the handle is at the end of the mean force's arrow
            handle = np.array(before["tip_measured"]) + ARROW_SCALE_M_PER_N * mean_force()
            drag(page, handle, FORCE_SIZE_M, 0, 0.02)

        drag_until(page, pull, lambda: bool(mean_force()[0] > 0.05))
        pulled = station.wait_for(lambda s: s["force"][0] > 0.1)
        picture(page, "hand")
        # The tip keeps its position under the force, because the joints have moved.
        held = station.wait_for(
            lambda s: 1e3 * np.linalg.norm(np.array(s["tip_true"]) - before["tip_true"]) < 1.0 and s["force"][0] > 0.1
        )
        assert pulled["state"] == held["state"] == "RUNNING"
        moved = [abs(held["joints"][name] - before["joints"][name]) for name in before["joints"]]
        assert max(moved) > 0.01
    finally:
        box.uncheck()
    station.wait_for(lambda s: abs(s["force"][0]) < 0.1)


# ---- contacts on the shaft, and the colours of the page


def orange(page: Page) -> int:
    """Return the number of pixels in the hue of a contact, whatever their shading."""
    seen, hue = pixels(page), np.array(CONTACT) / max(CONTACT)
    bright = seen.max(axis=-1, keepdims=True)
    return int(((np.abs(seen / np.maximum(bright, 1.0) - hue).max(axis=-1) < 0.12) & (bright[..., 0] > 120)).sum())


def test_contact_on_the_shaft_is_marked_and_reported(page: Page, station: Served, picture: Picture) -> None:
    page.get_by_role("button", name="Frame", exact=True).click()  # an earlier test's path has turned the view
    before = orange(page)
    load = {"kind": "contact", "magnitude": 0.3, "place": 0.1, "direction": [0.0, 1.0, 0.3]}
    station.post("/api/load", {"load": load})
    try:
        page.locator("#mind", has_text="load not at the tip").wait_for()
        until(lambda: orange(page) > before + 60)
        picture(page, "contact")
        page.locator("#mind").click()
        page.locator("#faults", has_text="the load does not act at the tip: contact at").wait_for()
    finally:
        station.post("/api/load", {"load": {"kind": "none"}})
        open_tab(page, "start")
    page.locator("#mind", has_text="load not at the tip").wait_for(state="hidden")


def test_scene_follows_the_page_to_the_dark_theme_and_back(page: Page, picture: Picture) -> None:
    def back() -> float:
        return float(np.median(pixels(page)))

    assert back() > 200
    page.emulate_media(color_scheme="dark")
    try:
        scene(page).locator("canvas").first.wait_for()
        until(lambda: back() < 60)
        picture(page, "dark")
    finally:
        page.emulate_media(color_scheme="light")
    scene(page).locator("canvas").first.wait_for()
    until(lambda: back() > 200)
