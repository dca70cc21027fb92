"""Every tab of the page next to the scene, as on the page *Use the page*: robot visible, texts present."""

from collections.abc import Callable

import imageio.v3 as iio
import numpy as np
from playwright.sync_api import Page

from tests.harness.chromium import open_tab
from tests.harness.serving import Served
from tests.harness.waiting import until

Picture = Callable[[Page, str], None]

DEMO = {"experiment": "demo"}  # this run first moves the robot to its start pose
#: A text that each tab must contain.
SAYS = {
    "start": "Free motions, from the current pose",
    "jog": "The robot moves while you hold a button",
    "devices": "Does every axis move in the right direction?",
    "plots": "drag to zoom",
    "runs": "demo",
    "faults": "Inject a fault into a simulated device",
}


def robot(page: Page) -> int:
    """Return the number of pixels left of the close-up that are as blue as the inner tube, whatever their shading."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    seen = iio.imread(page.screenshot(scale="css")).astype(float)[..., :3]
    red, green, blue = np.moveaxis(
        seen[int(box["y"]) : int(box["y"] + box["height"]), : int(0.6 * box["width"])], -1, 0
    )
    return int(((blue > red + 35) & (green > red + 10)).sum())


def test_robot_is_visible_next_to_every_tab_of_the_page_during_a_run(
    page: Page, station: Served, picture: Picture
) -> None:
    # A finished run is needed for the list of runs.
    assert station.post("/api/start", {"experiment": "demo"}).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving")
    station.ready()
    assert station.post("/api/start", DEMO).status_code == 202
    station.wait_for(lambda s: s["phase"] == "moving" and s["run"]["progress"] > 0.05)
    for name, text in SAYS.items():
        open_tab(page, name)
        page.locator(f"#{name}", has_text=text).wait_for()
        until(lambda: robot(page) > 100)
        picture(page, f"tab_{name}")
