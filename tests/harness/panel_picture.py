"""Take README's picture of the panel anew: `python -m tests.harness.panel_picture web/static/panel.png`.

A station of its own carries out the demonstration; the picture is taken half way, with the plots beside the scene.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.harness.chromium import CHROMIUM, FLAGS, PATIENCE, SIZE, SLOWLY
from tests.harness.serving import serving

#: Colours of the picture: enough that each is what it is on the screen, few enough for a small file.
COLOURS = 256


def main() -> None:
    """Into the file that is named."""
    with serving(rate=1.0) as station, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(PATIENCE)
        page.add_init_script(SLOWLY.replace("250", "2000"))  # a busy page is stale when its picture is taken
        page.goto(station.url)
        page.frame_locator("#scene").locator("canvas").first.wait_for()
        page.locator("#tab-plots").click()
        station.ready()
        answer = station.post("/api/start", {"experiment": "demo"})
        assert answer.status_code == 202, answer.text
        station.wait_for(lambda s: s["phase"] == "moving" and s["run"]["progress"] > 0.5)
        shot = b""
        while not shot:
            page.wait_for_function("() => !document.body.classList.contains('stale')")
            shot = page.screenshot()
            if "stale" in str(page.locator("body").get_attribute("class")):
                shot = b""
            assert station.status()["phase"] == "moving", "the page was stale whenever its picture was taken"
        browser.close()
    picture = Image.open(BytesIO(shot)).convert("RGB")
    picture.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(Path(sys.argv[1]), optimize=True)


if __name__ == "__main__":
    main()
