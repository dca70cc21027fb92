"""A client that forges messages of the scene."""

import msgspec
import viser
from playwright.sync_api import Browser
from websockets.sync.client import connect

from tests.harness.chromium import PATIENCE, SLOWLY
from tests.harness.serving import Served

#: Whether viser's page has the inner tube; viser exposes this for tests.
SHOWN = "() => '/robot/inner' in (window.__viserSceneTree?.getState() ?? {})"


def test_client_with_forged_scene_messages_changes_nothing_for_others(station: Served, browser: Browser) -> None:
    context = browser.new_context()
    context.set_default_timeout(PATIENCE)
    try:
        page = context.new_page()
        page.add_init_script(SLOWLY)
        page.goto(station.url)
        page.frame_locator("#scene").locator("canvas").first.wait_for()
        (scene,) = (frame for frame in page.frames if "/viser/" in frame.url)
        scene.wait_for_function(SHOWN)
        address = f"ws://127.0.0.1:{station.port}/viser/"
        with connect(address, subprotocols=[f"viser-v{viser.__version__}"], proxy=None, max_size=None) as socket:
            for message in (
                {"type": "RemoveSceneNodeMessage", "name": "/robot/inner", "owner": ""},
                {"type": "ResetGuiMessage"},
                {"type": "GuiRemoveMessage", "uuid": "x"},
                {"type": "RunJavascriptMessage", "source": "document.title = 'hacked'"},
                {"type": "ShareUrlRequest"},
            ):
                socket.send(msgspec.msgpack.encode(message))
            page.wait_for_timeout(1500)
        assert scene.evaluate(SHOWN)
        # The script would run in the scene's frame. The page's own title also shows the state.
        assert "hacked" not in {page.title(), scene.title()}
        assert station.status()["state"] == "READY"
    finally:
        context.close()


def test_reload_of_the_scene_does_not_transfer_its_program_again(station: Served) -> None:
    first = station.rest.get("/viser/")
    again = station.rest.get("/viser/", headers={"if-none-match": first.headers["etag"]})
    assert (first.status_code, again.status_code, again.content) == (200, 304, b"")
    assert len(first.content) > 100_000
