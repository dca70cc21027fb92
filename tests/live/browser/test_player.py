"""The stand-alone player in a real browser, opened as a file."""

from collections.abc import Iterator

import imageio.v3 as iio
import numpy as np
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from station.camera.video import VideoWriter
from station.cli.main import main
from station.devices.cameras import CameraFile
from station.recording.run_folder import VIDEOS_FOLDER
from station.report.run import read_run
from tests.harness.waiting import until

RUN = """
title = "player"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 2.0
settling = 0.0
[trajectory]
kind = "circle"
radius = 0.006
period = 8.0
[load]
kind = "constant"
magnitude = 0.3
[cases.one]
[cases.two.controller]
feedforward = true
"""


@pytest.fixture(scope="module")
def player(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    place = tmp_path_factory.mktemp("player")
    (place / "own.toml").write_text(RUN, encoding="utf-8")
    assert main(("run", str(place / "own.toml"), "--jobs", "1", "--out", str(place / "runs"), "--json")) == 0
    assert main(("replay", str(next((place / "runs").iterdir())), "--out", str(place / "own.html"))) == 0
    page = browser.new_page(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))

    def hear(message: ConsoleMessage) -> None:
        # A software renderer's messages about its speed are not caused by the page.
        if "GL Driver Message" not in message.text:
            complaints.append(message.text)

    page.on("console", hear)
    page.goto((place / "own.html").as_uri())
    yield page
    page.close()
    assert asked == [(place / "own.html").as_uri()]
    assert complaints == []


@pytest.fixture
def at_start(player: Page) -> Page:
    player.evaluate("() => play(false)")
    player.locator("#case").select_option("one")
    player.keyboard.press("Home")
    return player


@pytest.fixture(scope="module")
def filmed(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Open the player of a run with a video of 30 frames/s, whose frame number n has the grey level 20 + 3 n."""
    place = tmp_path_factory.mktemp("filmed")
    (place / "own.toml").write_text(RUN.replace("[cases.two.controller]\nfeedforward = true\n", ""), encoding="utf-8")
    assert main(("run", str(place / "own.toml"), "--jobs", "1", "--out", str(place / "runs"), "--json")) == 0
    folder = next((place / "runs").iterdir())
    camera = CameraFile(width=160, height=120, rate=30.0)
    writer = VideoWriter(folder / VIDEOS_FOLDER / "side.mcap", "side", camera, read_run(folder).cases[0].start)
    for number in range(70):
        writer.write(np.full((120, 160, 3), 20 + 3 * number, np.uint8), number / 30.0 - 0.1)
    writer.close()
    assert main(("replay", str(folder), "--out", str(place / "own.html"))) == 0
    page = browser.new_page(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    page.goto((place / "own.html").as_uri())
    yield page
    page.close()


#: JavaScript that returns the mean grey level of the shown frame of the camera.
GREY = """() => {
  const canvas = new OffscreenCanvas(1, 1), pen = canvas.getContext("2d");
  pen.drawImage(document.querySelector("#cameras video"), 0, 0, 1, 1);
  return pen.getImageData(0, 0, 1, 1).data[1];
}"""


@pytest.mark.parametrize("time", [0.0, 1.8])
def test_picture_of_a_camera_is_that_of_the_cursor_of_the_replay(filmed: Page, time: float) -> None:
    filmed.evaluate("(time) => { play(false); go(shown.times.findIndex((one) => one > time - 1e-6)); }", time)
    # Frame number 3 was exposed at the motion's start. A step of one frame is three levels.
    until(lambda: abs((filmed.evaluate(GREY) - 20.0) / 3.0 - (3.0 + 30.0 * time)) <= 1.0)
    assert filmed.locator("#cameras figcaption").inner_text() == "camera side, simulated"
    tubes, balls = (filmed.locator(f"#cameras {kind}").count() for kind in ("polyline", "circle"))
    assert (tubes, balls) == (2, 2)


def test_picture_of_a_camera_can_be_enlarged_in_the_replay(filmed: Page) -> None:
    button = filmed.get_by_role("button", name="picture of camera side")
    before = button.bounding_box()
    button.click()
    after = button.bounding_box()
    assert before is not None
    assert after is not None
    assert after["width"] > 1.4 * before["width"]
    button.click()


def picture(page: Page) -> np.ndarray:
    return iio.imread(page.locator("#scene").screenshot()).astype(float)[..., :3]


def clock(page: Page) -> float:
    return float(page.locator("#clock").inner_text().split()[0])


def test_replay_player_starts_paused_with_reduced_motion_and_labels_its_contents(at_start: Page) -> None:
    expect(at_start.locator("#play")).to_have_text("Play")
    until(lambda: clock(at_start) == 0.0)
    expect(at_start.locator("#origin")).to_have_text("simulated bench")
    legend = at_start.locator("#legend").inner_text()
    for name in ("inner tube", "outer tube", "desired tip", "measured tip", "true tip", "force"):
        assert name in legend
    numbers = at_start.locator("#numbers").inner_text()
    for name in ("tip, measured", "true error", "force", "inner translation", "mm", "deg", "N"):
        assert name in numbers
    expect(at_start.locator("#problem")).to_be_hidden()


def test_replay_player_draws_the_robot_in_its_colours(at_start: Page) -> None:
    shot = picture(at_start)
    # sky blue of the inner tube and slate of the outer tube, whatever the shading
    blue = (shot[..., 2] > shot[..., 0] + 60) & (shot[..., 1] > shot[..., 0] + 30)
    slate = (np.abs(shot - (86, 98, 112)).max(axis=-1) < 45) & (shot[..., 2] > shot[..., 0] + 5)
    assert blue.sum() > 300
    assert slate.sum() > 300


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (830, 590), (390, 420)])
def test_tables_of_the_replay_player_do_not_cover_the_robot(at_start: Page, width: int, height: int) -> None:
    before = at_start.viewport_size
    at_start.set_viewport_size({"width": width, "height": height})
    scene, numbers = (at_start.locator(name).bounding_box() for name in ("#scene", "#side"))
    assert before is not None
    at_start.set_viewport_size(before)

    assert scene is not None
    assert numbers is not None
    assert scene["width"] > 0.5 * width
    assert scene["height"] > 0.25 * height
    beside = numbers["x"] >= scene["x"] + scene["width"] - 1.0
    below = numbers["y"] >= scene["y"] + scene["height"] - 1.0
    assert beside or below


def test_keys_change_the_time_and_the_picture_of_the_replay_player(at_start: Page) -> None:
    page = at_start
    before = picture(page)
    page.keyboard.press("ArrowRight")
    until(lambda: clock(page) == pytest.approx(0.04))
    page.keyboard.press("Shift+ArrowRight")
    until(lambda: clock(page) == pytest.approx(1.04))
    page.keyboard.press("End")
    until(lambda: clock(page) == pytest.approx(1.96, abs=0.05))
    until(lambda: (np.abs(picture(page) - before).max(axis=-1) > 40).sum() > 200)
    page.keyboard.press("Home")
    until(lambda: clock(page) == 0.0)
    until(lambda: np.abs(picture(page) - before).max() < 3.0)


def test_space_key_plays_a_replay_to_its_end_and_stops_there(at_start: Page) -> None:
    page = at_start
    speed = page.locator("#speed")
    speed.select_option("0.1")  # slowly, so that the replay has not ended before the second press on a busy computer
    page.locator("#scene").focus()
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Pause")
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Play")
    speed.select_option("5")
    page.locator("#scene").focus()
    page.keyboard.press("Space")
    page.wait_for_function("() => Number(document.querySelector('#time').value) > 47")
    page.locator("#play", has_text="Play").wait_for()
    until(lambda: clock(page) > 1.9)
    speed.select_option("0.1")
    page.locator("#play").click()  # the player starts again from the first frame
    until(lambda: clock(page) < 1.0)
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Play")


def test_slider_mouse_and_case_change_the_picture_of_the_replay_player(at_start: Page) -> None:
    page = at_start
    page.locator("#time").fill("25")
    until(lambda: clock(page) == pytest.approx(1.0))
    before = picture(page)
    page.mouse.move(600, 300)
    page.mouse.down()
    page.mouse.move(760, 340, steps=4)
    page.mouse.up()
    until(lambda: (np.abs(picture(page) - before).max(axis=-1) > 40).sum() > 500)
    text = page.locator("#numbers").inner_text()
    page.locator("#case").select_option("two")
    until(lambda: clock(page) == pytest.approx(1.0))
    expect(page.locator("#numbers")).not_to_have_text(text)


def test_replay_player_shows_the_numbers_of_the_recording(at_start: Page) -> None:
    rows = [row.split("\t") for row in at_start.locator("#numbers").inner_text().splitlines()]
    joints = {row[0]: row[1] for row in rows if "rotation" in row[0] or "translation" in row[0]}
    assert float(joints["inner rotation"]) == pytest.approx(90.0, abs=0.5)
    assert float(joints["inner translation"]) == pytest.approx(-100.0, abs=0.5)


#: JavaScript that returns the measured tip's position in each frame; the picture's edges are at -1 and 1.
TIPS = """() => {
  choose(0);
  const m = scene.view, part = (row, p) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row];
  const tips = Array.from({ length: shown.frames }, (_, k) => shown.tip(k, 1));
  return tips.map((p) => [part(0, p) / part(3, p), part(1, p) / part(3, p)]);
}"""


@pytest.mark.parametrize("size", [(390, 844), (500, 900), (1280, 720)])
def test_replay_player_shows_the_tip_at_every_aspect_ratio(at_start: Page, size: tuple[int, int]) -> None:
    before = at_start.viewport_size
    assert before is not None
    at_start.set_viewport_size({"width": size[0], "height": size[1]})
    try:
        assert np.abs(at_start.evaluate(TIPS)).max() < 0.9
    finally:
        at_start.set_viewport_size(before)
        at_start.evaluate("() => choose(0)")
