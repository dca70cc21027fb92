"""A small window over the scene's lower left corner: views to choose from, and which marker is what."""

import numpy as np
import viser

from core.robot.robot import Robot
from station.config import palette
from web.scene.overlays import LARGER, SIGMAS

#: Of the camera, from top to bottom [rad].
FIELD = np.deg2rad(35.0)
#: A narrower picture than this, width by height, is looked at from further away.
NARROW = 1.35
#: Where the camera stands and what it looks at, scene units; x points down on the screen.
VIEWS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "Overview": ((-1.4, -4.2, 2.3), (0.2, -0.1, 0.66)),
    "Side": ((0.2, -5.0, 1.0), (0.2, 0.0, 1.0)),
    "Above": ((-5.0, -0.05, 1.0), (0.0, -0.05, 1.0)),
    "Front": ((0.2, -0.1, 6.0), (0.2, -0.1, 0.0)),
    "Tip": ((-0.3, -1.6, 2.6), (0.25, -0.4, 1.94)),
}


def add_legend(server: viser.ViserServer, robot: Robot) -> dict[str, tuple[str, ...]]:
    """Buttons that move the camera of the one who presses them, and signs and names of what is drawn.

    Returns:
        The values that each button group may have, by its identity.
    """
    gui = server.gui
    gui.configure_theme(show_logo=False, show_share_button=False, brand_color=palette.BLUE)
    panel = gui.add_panel()
    with panel.add_tab("Legend"):
        gui.add_html(f'<div style="padding:4px 8px;font-size:12px">{_rows(robot)}</div>')
    with panel.add_tab("View"):
        views = gui.add_button_group("Camera", tuple(VIEWS))
    panel.float(x=12, y=-12, width=262)

    # On viser's own thread, and for the one client only.
    async def look(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        if event.client is not None and event.target.value in VIEWS:
            _place_camera(event.client, event.target.value)

    @server.on_client_connect
    async def _(client: viser.ClientHandle) -> None:
        if client.camera.aspect < NARROW:
            _place_camera(client, "Overview")

    views.on_click(look)
    return {views._impl.uuid: tuple(VIEWS)}


def _place_camera(client: viser.ClientHandle, view: str) -> None:
    eye, centre = (np.array(place) for place in VIEWS[view])
    with client.atomic():
        client.camera.up_direction = (0.0, 1.0, 0.0) if view == "Above" else (-1.0, 0.0, 0.0)
        client.camera.position = centre + max(1.0, NARROW / client.camera.aspect) * (eye - centre)
        client.camera.look_at = centre


def _rows(robot: Robot) -> str:
    entries = [
        (_disc(palette.DESIRED, 14, 0.45), "desired tip"),
        (_disc(palette.MEASURED, 9), "measured tip, trace of 20 s"),
        (_disc(palette.ESTIMATED, 9, corner=1), "estimated tip (loaded model)"),
        (_bar(palette.FORCE, 3), "force, 100 mm for 1 N"),
        (_bar(palette.CONTACT, 5), "contact on the shaft, 95 %"),
        (_bar(palette.DESIRED, 2), "reference path"),
        *((_bar(palette.tube(number), 5), f"tube '{tube.name}'") for number, tube in enumerate(robot.tubes)),
        (_bar(palette.SLATE, 2), "shape without load (on demand)"),
        (_disc(palette.ESTIMATED, 14, 0.3), f"uncertainty, {SIGMAS:g} sigma, {LARGER:g} times"),
    ]
    return "".join(
        f'<div style="display:flex;align-items:center;height:19px"><span style="width:26px;display:flex;'
        f'justify-content:center">{sign}</span><span style="margin-left:6px">{name}</span></div>'
        for sign, name in entries
    )


def _disc(colour: palette.Colour, size: int, opacity: float = 1.0, corner: int = 50) -> str:
    return (
        f'<span style="width:{size}px;height:{size}px;border-radius:{corner}%;background:{palette.css(colour)};'
        f'opacity:{opacity}"></span>'
    )


def _bar(colour: palette.Colour, thickness: int) -> str:
    return f'<span style="width:22px;height:{thickness}px;border-radius:2px;background:{palette.css(colour)}"></span>'
