"""Take the pictures of the page for the documents: `python -m tests.tools.page_pictures web/pictures [NAME ...]`.

Without a name the program takes all pictures of the page *Use the page*; `... page_pictures web/static panel` takes
the picture of the main README. The pictures show stations in virtual labs, each with its scene and during an activity.
On a busy computer a run may end in HOLD; the program then reports this, and the missing pictures must be requested by
name.
"""

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from PIL import Image
from playwright.sync_api import Browser, FilePayload, FloatRect, Page

from tests.harness.chromium import PATIENCE, SIZE, SLOWLY, VISITED, chromium, open_tab
from tests.harness.pad import LEFT, PAD
from tests.harness.serving import Served, serving

#: Number of colours of a picture: enough to appear like the screen, and few enough for a small file.
COLOURS = 256
#: Time for the scene to be drawn before a picture is taken [s].
DRAWN = 5.0
HEADER: FloatRect = {"x": 0, "y": 0, "width": 1280, "height": 56}
#: JavaScript that counts how often the page became stale or current, and checks that page, close-up and numbers are
#: current.
COUNTING = """() => { window.turnedOld = 0;
  new MutationObserver(() => { window.turnedOld += 1; }).observe(document.body, { attributeFilter: ["class"] }); }"""
FRESH = """() => !document.body.classList.contains("stale")
  && document.querySelector("#tip p").textContent !== "no data about the tip"
  && /[0-9]/.test(document.querySelector("#strip [data-quantity=force] + output").textContent)"""
PLACES = "time [s], x [mm], y [mm], z [mm]\n0, 0, 0, 0\n4, 0, 8, 0\n8, 6, 8, 4\n12, 6, 0, 6\n16, 0, 0, 0\n"
DEMO = {"experiment": "demo"}
#: A press with 0.3 N on a wall, which lasts until the picture is taken on a busy computer, too.
PRESS = {
    "trajectory": {"kind": "force", "direction": [1.0, 0.0, 0.0], "force": 0.3},
    "load": {"kind": "wall", "direction": [-1.0, 0.0, 0.0], "distance": 0.004, "stiffness": 1000.0},
    "duration": 600.0,
}


class Desk(NamedTuple):
    """A station and a user's page of it."""

    station: Served
    page: Page

    def shot(self, clip: FloatRect | None = None) -> bytes:
        """Return a picture of the current page in which no value is stale."""
        for close in self.page.locator("#notes").get_by_role("button", name="close").all():
            close.click()
        state = self.station.status()["state"]
        time.sleep(DRAWN)
        while True:
            self.page.wait_for_function(FRESH)
            before = self.page.evaluate("() => window.turnedOld")
            picture = self.page.screenshot(clip=clip)
            now = self.station.status()
            assert now["state"] == state, f"{state} has become {now['state']}: {now['message']}"
            if self.page.evaluate("() => window.turnedOld") == before and self.page.evaluate(FRESH):
                return picture

    def start(self, body: Mapping[str, object], progress: float) -> None:
        """Start a run from READY and wait until `progress` of its motion is over (0 ... 1)."""
        self.station.ready()
        answer = self.station.post("/api/start", body)
        assert answer.status_code == 202, answer.text
        self.station.wait_for(lambda s: s["state"] != "RUNNING" or (s["run"]["progress"] or 0.0) > progress)
        assert self.station.status()["state"] == "RUNNING", self.station.status()["cause"]

    def tab(self, name: str) -> None:
        open_tab(self.page, name)


def run(desk: Desk) -> bytes:
    desk.start(DEMO, 0.3)
    desk.tab("start")
    return desk.shot()


def jog(desk: Desk) -> bytes:
    desk.station.ready()
    desk.tab("jog")
    return desk.shot()


def touch(desk: Desk) -> bytes:
    """Picture of the tab Run while the tip holds a force on a wall."""
    desk.tab("start")
    desk.start(PRESS, 0.02)
    return desk.shot()


def pad(desk: Desk) -> bytes:
    """Picture of the tab Jog while a gamepad moves the tip back along the tubes."""
    desk.station.ready()
    desk.tab("jog")
    desk.page.locator("#hands").scroll_into_view_if_needed()
    desk.page.locator("#hands").evaluate("box => box.scrollIntoView({ block: 'start' })")
    desk.page.evaluate(PAD, {"axes": [0.0] * 4, "held": False, "obeys": True})
    desk.page.locator("#hands [role=status]", has_text="hold a shoulder button").wait_for()
    desk.page.evaluate(PAD, {"axes": [0.4 * x for x in LEFT], "held": True, "obeys": True})
    desk.page.locator("#state", has_text="RUNNING").wait_for()
    picture = desk.shot()
    desk.page.evaluate(PAD, None)
    desk.station.wait_for(lambda s: s["state"] == "READY")
    return picture


def places(desk: Desk) -> bytes:
    desk.station.ready()
    desk.tab("start")
    desk.page.locator(".card", has_text="Move smoothly through").click()
    file = FilePayload(name="places.csv", mimeType="text/csv", buffer=PLACES.encode())
    desk.page.get_by_label("CSV file").set_input_files(file)
    desk.page.locator(".teach [role=status]", has_text="✓ according to the model").wait_for()
    picture = desk.shot()
    desk.page.get_by_role("button", name="all motions").click()
    return picture


def panel(desk: Desk) -> bytes:
    """Picture of the demonstration half way, with the plots next to the scene."""
    desk.tab("plots")
    desk.start(DEMO, 0.5)
    return desk.shot()


def devices(desk: Desk) -> bytes:
    desk.start(DEMO, 0.3)
    desk.tab("devices")
    return desk.shot()


def plots(desk: Desk) -> bytes:
    desk.tab("plots")
    desk.start(DEMO, 0.3)
    desk.start(DEMO, 0.3)
    return desk.shot()


def runs(desk: Desk) -> bytes:
    desk.start(DEMO, 0.3)
    desk.tab("runs")
    return desk.shot()


def faults(desk: Desk) -> bytes:
    desk.start(DEMO, 0.3)
    desk.tab("faults")
    return desk.shot()


def hold(desk: Desk) -> bytes:
    desk.start(DEMO, 0.2)
    desk.station.post("/api/faults", {"faults": [{"kind": "lose_tool", "device": "tracker"}]})
    desk.page.locator("#state", has_text="HOLD").wait_for()
    return desk.shot({**HEADER, "height": 150})  # with the bar below it, which has the cause


def contact(desk: Desk) -> bytes:
    desk.station.ready()
    desk.tab("faults")
    load = {"kind": "contact", "magnitude": 0.3, "place": 0.1, "direction": [0.0, 1.0, 0.3]}
    desk.station.post("/api/load", {"load": load})
    desk.page.locator("#mind", has_text="load not at the tip").wait_for()
    picture = desk.shot()
    desk.station.post("/api/load", {"load": {"kind": "none"}})
    return picture


def dark(desk: Desk) -> bytes:
    desk.start(DEMO, 0.3)
    desk.tab("plots")
    desk.page.emulate_media(color_scheme="dark")
    picture = desk.shot()
    desk.page.emulate_media(color_scheme="light")
    return picture


def follow(desk: Desk) -> bytes:
    """Picture of a run that follows the target of a virtual lab."""
    desk.tab("start")
    desk.page.locator(".card", has_text="Follow: the tip keeps its offset").click()
    desk.start({"experiment": "follow", "case": "breathing"}, 0.4)
    return desk.shot()


#: Functions that take the pictures, by the virtual lab that they need and in their order.
PICTURES: dict[str, tuple[Callable[[Desk], bytes], ...]] = {
    "gentle": (jog, touch, places, pad, run, devices, plots, runs, faults, dark, hold, contact, panel),
    "breathing": (follow,),
}
#: Names of the pictures that are taken if the command names none: all except the main README's picture.
USUAL = {take.__name__ for pictures in PICTURES.values() for take in pictures} - {"panel"}


@contextmanager
def at(lab: str, browser: Browser) -> Iterator[Desk]:
    """Yield a station in a virtual lab with its page, whose scene is drawn."""
    with serving("--lab", lab, rate=1.0) as station:
        page = browser.new_page(viewport=SIZE, color_scheme="light")
        page.set_default_timeout(PATIENCE)
        page.add_init_script(VISITED)
        page.add_init_script(SLOWLY.replace("250", "2000"))  # slower, or the page is stale
        page.goto(station.url)
        page.frame_locator("#scene").locator("canvas").first.wait_for()
        page.locator(".card", has_text="demo").first.wait_for()
        page.evaluate(COUNTING)
        yield Desk(station, page)
        page.close()


def keep(picture: bytes, path: Path) -> None:
    """Write a picture with few colours, so that its file is small."""
    # Colours are chosen by presence, not by area, because the tip's colour covers only a few pixels.
    few = Image.open(BytesIO(picture)).convert("RGB")
    few = few.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=5, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def main() -> None:
    """Take all pictures, or those that are named, and write them to the given folder."""
    folder, wanted = Path(sys.argv[1]), set(sys.argv[2:])
    with chromium() as browser:
        for lab, pictures in PICTURES.items():
            chosen = [take for take in pictures if take.__name__ in (wanted or USUAL)]
            if chosen:
                with at(lab, browser) as desk:
                    for take in chosen:
                        keep(take(desk), folder / f"{take.__name__}.png")
                        print(take.__name__, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
