"""The close-up of the tip: it frames the desired path, the tip and the arrow of the force."""

from playwright.sync_api import Page

from tests.harness.chromium import SIZE
from tests.harness.serving import Served

#: Run that lasts longer than the test.
CIRCLE = {
    "trajectory": {"kind": "circle", "radius": 0.01, "period": 30.0},
    "load": {"kind": "constant", "magnitude": 0.3},
    "duration": 3600.0,
}
MARKS = ("reference", "force", "measured")
#: Smallest distance of the pixels of each colour from the edges of the picture and from its ruler, which is 24 px high
#: [px]; null until the picture contains all colours.
MARGINS = """(colours) => {
    const canvas = document.querySelector("#tip canvas"), { width, height } = canvas, bottom = height - 24;
    if (width === 0 || height === 0) return null;
    const { data } = canvas.getContext("2d").getImageData(0, 0, width, bottom);
    const margins = colours.map((colour) => {
        const rgb = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
        let margin = null;
        for (let y = 0; y < bottom; y++) for (let x = 0; x < width; x++) {
            const first = 4 * (y * width + x);
            if (rgb.some((one, i) => Math.abs(one - data[first + i]) > 12)) continue;
            margin = Math.min(margin ?? Infinity, x, y, width - 1 - x, bottom - 1 - y);
        }
        return margin;
    });
    return margins.includes(null) ? null : margins;
}"""


def test_close_up_contains_the_path_the_tip_and_the_force_in_a_small_window(page: Page, station: Served) -> None:
    signs = station.rest.get("/api/scene/legend").json()["signs"]
    colours = [next(sign["colour"] for sign in signs if sign["name"].startswith(mark)) for mark in MARKS]
    page.set_viewport_size({"width": 1024, "height": 768})
    try:
        assert station.post("/api/start", CIRCLE).status_code == 202
        station.wait_for(lambda s: s["phase"] == "moving")
        margins = page.wait_for_function(MARGINS, arg=colours).json_value()
        assert min(margins) >= 2, dict(zip(MARKS, margins, strict=True))
    finally:
        page.set_viewport_size(SIZE)
