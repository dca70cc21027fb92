"""The tab Cameras in Chromium: live pictures with the model over them, snapshots, and no stream while it is closed."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, Route, expect

from tests.harness.chromium import open_tab
from tests.harness.serving import Served, serving
from tests.harness.waiting import until

Picture = Callable[[Page, str], None]
SETTINGS = """
[cameras.side]

[cameras.top]
pose = { position = [-0.4, 0.0, 0.13], rotation_vector = [2.221441469079183, 0.0, 2.221441469079183] }

[cameras.usb]
device = "/dev/v4l/by-id/usb-none-video-index0"
"""
#: Whether an image element shows a picture, whose background is grey.
BRIGHT = """(image) => {
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  if (image.naturalWidth === 0) return false;
  pen.drawImage(image, 0, 0, 8, 8);
  return pen.getImageData(4, 1, 1, 1).data[1] > 40;
}"""
RULES = {"iframes": False, "runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}}


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving(settings=SETTINGS) as served:
        yield served


def camera(station: Served, name: str) -> dict[str, Any]:
    return next(one for one in station.rest.get("/api/cameras").json() if one["name"] == name)


def wait_for_pictures(page: Page) -> None:
    """Wait until both simulated cameras show a picture with the model over it."""
    for name in ("side", "top"):
        figure = page.locator(".camera", has=page.get_by_text(name, exact=True))
        handle = figure.locator("img").element_handle()
        page.wait_for_function("(image) => image.naturalWidth === 640", arg=handle)
        figure.locator("polyline.model").wait_for(state="attached")
        figure.locator("circle.measured").wait_for(state="attached")


@pytest.mark.parametrize(("width", "height", "name"), [(1440, 900, "cameras"), (390, 844, "cameras_phone")])
def test_tab_shows_live_pictures_with_the_model_and_has_no_axe_violation(
    page: Page, station: Served, picture: Picture, width: int, height: int, name: str
) -> None:
    page.set_viewport_size({"width": width, "height": height})
    try:
        open_tab(page, "cameras")
        wait_for_pictures(page)
        page.locator(".camera output", has_text="frames/s").first.wait_for()
        page.locator(".camera p", has_text="no such device").wait_for()
        page.evaluate("() => document.querySelector('#cameras').scrollTo(0, 0)")
        picture(page, name)
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            found = Axe().run(page, {"exclude": [["#scene"]]}, RULES).response["violations"]
            assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})
        open_tab(page, "start")


def test_stream_ends_when_the_tab_is_closed_and_starts_again(page: Page, station: Served) -> None:
    open_tab(page, "cameras")
    until(lambda: camera(station, "side")["watched"])
    open_tab(page, "jog")
    until(lambda: not camera(station, "side")["watched"])
    open_tab(page, "cameras")
    until(lambda: camera(station, "side")["watched"])
    wait_for_pictures(page)
    open_tab(page, "start")


def test_large_picture_replaces_the_scene_and_stays_while_another_tab_is_open(
    page: Page, station: Served, picture: Picture
) -> None:
    page.set_viewport_size({"width": 1440, "height": 900})
    open_tab(page, "cameras")
    page.locator(".camera", has_text="side").get_by_role("button", name="Large").click()
    open_tab(page, "jog")
    large = page.locator("#camera-large")
    large.locator("polyline.model").wait_for(state="attached")
    page.wait_for_function(BRIGHT, arg=large.locator("img").element_handle())
    picture(page, "camera_large")
    until(lambda: camera(station, "side")["watched"])  # moving the picture has ended its stream, and begun another one
    large.get_by_role("button", name="Small").click()
    expect(large).to_be_hidden()
    until(lambda: not camera(station, "side")["watched"])
    page.set_viewport_size({"width": 1280, "height": 720})


def test_model_over_the_picture_can_be_switched_off_and_a_snapshot_saved(page: Page) -> None:
    open_tab(page, "cameras")
    wait_for_pictures(page)
    figure = page.locator(".camera", has_text="side")
    figure.get_by_label("model over the picture").uncheck()
    expect(figure.locator("polyline")).to_have_count(0)
    with page.expect_download() as download:
        figure.get_by_role("button", name="Snapshot").click()
    assert download.value.suggested_filename.startswith("side-")
    page.locator(".note", has_text="saved the picture").wait_for()
    page.locator(".camera", has_text="usb").get_by_role("button", name="Snapshot").click()
    page.locator(".note", has_text="no picture of camera usb").wait_for()
    open_tab(page, "start")


def test_answer_that_arrives_after_the_model_was_switched_off_is_not_drawn(page: Page) -> None:
    open_tab(page, "cameras")
    figure = page.locator(".camera", has_text="side")
    box = figure.get_by_label("model over the picture")
    held: list[Route] = []
    # The page gives up after 4 s; on a busy computer the answer may be held for longer.
    page.evaluate("window.limit = AbortSignal.timeout; AbortSignal.timeout = () => new AbortController().signal")
    page.route("**/api/cameras/side/overlay", lambda route: held.append(route))
    box.check()
    until(lambda: page.evaluate("() => 1") == len(held))  # each evaluation lets the browser's events arrive
    box.uncheck()
    with page.expect_event("requestfinished", lambda request: request.url.endswith("/api/cameras/side/overlay")):
        held[0].continue_()
    page.unroute_all()
    page.evaluate("AbortSignal.timeout = window.limit")
    page.wait_for_timeout(300)  # time to draw the answer
    expect(figure.locator("polyline")).to_have_count(0)
    box.check()
    expect(figure.locator("polyline")).not_to_have_count(0)
    open_tab(page, "start")


def test_video_of_a_run_is_shown_in_the_history(page: Page, station: Served, picture: Picture) -> None:
    run = station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 3.0}).json()["run_id"]
    station.wait_for(lambda status: status["state"] == "READY" and not status["run"]["recording"])
    until(lambda: len(station.rest.get(f"/api/runs/{run}").json()["videos"]) == 2)
    open_tab(page, "runs")
    page.locator("#runs .card").first.click()
    page.locator("summary", has_text="Video of camera side").click()
    video = page.locator("video")
    page.wait_for_function("(video) => video.readyState > 1 && video.videoWidth === 640", arg=video.element_handle())
    video.scroll_into_view_if_needed()
    picture(page, "video")
    page.get_by_role("button", name="all runs").click()
    open_tab(page, "start")


def test_calibration_with_the_board_is_started_shown_and_cancelled(
    page: Page, station: Served, picture: Picture
) -> None:
    open_tab(page, "cameras")
    board = page.locator("#board")
    printed = board.get_by_role("link", name="Open the board to print").get_attribute("href")
    assert "<svg" in station.rest.get(str(printed)).text
    board.get_by_label("side of a square of the board [mm]").fill("20")
    for name, wanted in (("side", True), ("top", True), ("usb", False)):
        board.get_by_label(name, exact=True).set_checked(wanted)
    board.get_by_role("button", name="Start").click()
    board.locator(".task", has_text="hold the board").wait_for()
    page.locator(".camera-picture circle.corner").first.wait_for(state="attached")
    board.locator(".board-seen rect.seen").first.wait_for()
    expect(board.get_by_role("button", name="Compute result")).to_be_disabled()
    picture(page, "board")
    assert Axe().run(page, options=RULES).response["violations"] == []

    board.get_by_role("button", name="Cancel").click()

    board.get_by_text("cancelled; nothing was written").wait_for()
    expect(board.get_by_role("button", name="Start")).to_be_visible()
    station.ready()
