"""Every tab beside the scene, as `web/README.md` shows them: the robot is seen, and the words are there."""

from collections.abc import Callable

import imageio.v3 as iio
import numpy as np
import pytest
from playwright.sync_api import Page

from tests.serving import Served
from web.palette import SKY

Picture = Callable[[Page, str], None]

CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.008, "period": 8.0, "normal": [0.0, 1.0, 0.0]}}
WEIGHT = {"load": {"kind": "raised_cosine", "peak": 0.3, "period": 15.0}}
#: What each tab must say.
SAYS = {
    "start": "Free motions, from where the robot is",
    "jog": "The robot moves while a button is held",
    "devices": "Does every axis turn the right way?",
    "plots": "drag over a chart to zoom",
    "runs": "circle, free motion",
    "faults": "Let a simulated device fail",
}


def robot(page: Page) -> int:
    """Pixels of the inner tube, whatever the shading: bluer than green, greener than red."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    clip = {"x": box["x"] + 280, "y": box["y"], "width": box["width"] - 280, "height": box["height"]}
    seen = iio.imread(page.screenshot(clip=clip)).astype(float)[..., :3]  # type: ignore[arg-type]
    hue = np.array(SKY, float) / max(SKY)
    bright = seen.max(axis=-1)
    return int(((np.abs(seen / np.maximum(bright, 1.0)[..., None] - hue).max(axis=-1) < 0.08) & (bright > 90)).sum())


@pytest.mark.parametrize("name", list(SAYS))
def test_a_tab_beside_the_scene_during_a_run(page: Page, station: Served, name: str, picture: Picture) -> None:
    station.post("/api/start", CIRCLE | {"duration": 1.0})
    station.wait_for(lambda s: s["state"] == "READY" and s["run"] is not None, 15.0)
    station.post("/api/start", CIRCLE | WEIGHT | {"duration": 60.0})
    station.wait_for(lambda s: s["phase"] == "moving" and s["run"]["progress"] > 0.15, 30.0)
    page.locator(f"#tab-{name}").click()
    page.locator(f"#{name}", has_text=SAYS[name]).wait_for(timeout=10_000)
    page.wait_for_timeout(1500)
    picture(page, f"tab_{name}")
    assert robot(page) > 200


def test_the_header_in_hold_says_why_and_what_to_do(page: Page, station: Served, picture: Picture) -> None:
    station.post("/api/start", CIRCLE | {"duration": 60.0})
    station.wait_for(lambda s: s["phase"] == "moving", 15.0)
    station.post("/api/faults", {"faults": [{"kind": "lose_tool", "device": "tracker", "duration": 3.0}]})
    page.locator("#state", has_text="HOLD").wait_for(timeout=8000)
    page.locator("#lights .light:not([data-severity='0'])").first.wait_for(timeout=5000)
    assert page.locator("#says").inner_text() != ""
    assert "Reset" in page.locator("#next").inner_text()
    picture(page, "hold")
    station.wait_for(lambda s: s["devices"]["tracker"]["severity"] == 0, 10.0)
