"""Take README's picture of the panel anew: `python -m tests.harness.panel_picture web/static/panel.png`.

A station of its own carries out the demonstration; the picture is taken half way, with the plots beside the scene.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.harness.chromium import CHROMIUM, FLAGS, scene_page
from tests.harness.serving import serving

#: Colours of the picture: enough that each is what it is on the screen, few enough for a small file.
COLOURS = 256


def main() -> None:
    """Into the file that is named."""
    with serving(rate=1.0) as station, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = scene_page(browser)
        page.goto(station.url)
        page.frame_locator("#scene").locator("canvas").first.wait_for()
        page.locator("#tab-plots").click()
        station.ready()
        answer = station.post("/api/start", {"experiment": "demo"})
        assert answer.status_code == 202, answer.text
        station.wait_for(lambda s: s["phase"] == "moving" and s["run"]["progress"] > 0.5)
        shot = page.screenshot()
        browser.close()
    picture = Image.open(BytesIO(shot)).convert("RGB")
    picture.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(Path(sys.argv[1]), optimize=True)


if __name__ == "__main__":
    main()
