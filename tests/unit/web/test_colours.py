"""One colour for a quantity: the page's colours have the hues of the palette of scene, replay and report."""

import colorsys
import re

import pytest

from station.config import palette
from tests.harness.root import ROOT

STYLE = (ROOT / "web/static/page/page.css").read_text(encoding="utf-8")
QUANTITIES = {
    "desired": palette.DESIRED, "measured": palette.MEASURED, "force": palette.FORCE, "error": palette.TRUE,
}  # fmt: skip


def hue(red: int, green: int, blue: int) -> float:
    """Return the hue [degree]."""
    return 360.0 * colorsys.rgb_to_hsv(red / 255, green / 255, blue / 255)[0]


@pytest.mark.parametrize(("name", "colour"), QUANTITIES.items())
def test_a_quantity_has_one_hue_on_the_page_and_in_the_scene(name: str, colour: palette.Colour) -> None:
    shown = re.findall(rf"--{name}: #([0-9a-f]{{6}});", STYLE)
    assert len(shown) == 2  # light and dark
    for text in shown:
        distance = abs(hue(*bytes.fromhex(text)) - hue(*colour)) % 360.0
        assert min(distance, 360.0 - distance) < 15.0, text
