"""Which marker of the scene is what: a small window over its lower left corner."""

import viser

from core.robot import Robot
from web import palette


def add_legend(gui: viser.GuiApi, robot: Robot) -> None:
    """Signs and names of everything that is drawn at or near the tip."""
    entries = [
        (_disc(palette.DESIRED, 14, 0.45), "desired tip"),
        (_disc(palette.MEASURED, 9), "measured tip, trace of 20 s"),
        (_disc(palette.ESTIMATED, 9, corner=1), "estimated tip (loaded model)"),
        (_bar(palette.FORCE, 3), "force, 100 mm for 1 N"),
        (_bar(palette.DESIRED, 2), "reference path"),
        *((_bar(palette.tube(number), 5), f"tube '{tube.name}'") for number, tube in enumerate(robot.tubes)),
    ]
    rows = "".join(
        f'<div style="display:flex;align-items:center;height:19px"><span style="width:26px;display:flex;'
        f'justify-content:center">{sign}</span><span style="margin-left:6px">{name}</span></div>'
        for sign, name in entries
    )
    panel = gui.add_panel()
    with panel.add_tab("Legend"):
        gui.add_html(f'<div style="padding:4px 8px;font-size:12px;color:#343a40">{rows}</div>')
    panel.float(x=12, y=-12, width=230)


def _disc(colour: palette.Colour, size: int, opacity: float = 1.0, corner: int = 50) -> str:
    return (
        f'<span style="width:{size}px;height:{size}px;border-radius:{corner}%;background:{palette.css(colour)};'
        f'opacity:{opacity}"></span>'
    )


def _bar(colour: palette.Colour, thickness: int) -> str:
    return f'<span style="width:22px;height:{thickness}px;border-radius:2px;background:{palette.css(colour)}"></span>'
