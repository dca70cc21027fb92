"""Live plots of the last seconds: the errors of the tip and the force on it."""

import time
from collections.abc import Callable

import numpy as np
import viser
from viser import uplot

from core.robot import Array
from web.history import SPAN, History, Point
from web.palette import AXES, css

HEIGHT = 130  #: with its axes [px]
QUIET = 3.0  #: without new data after a browser has come [s]
FONT = "11px sans-serif"


class Plots:
    """Error against the tracker, force, and error against the simulated truth."""

    def __init__(self, server: viser.ViserServer) -> None:
        gui = server.gui
        self._newcomer = -QUIET
        self._refitted = False
        server.on_client_connect(self._welcome)
        self._error = _Plot(gui, "Tip error, desired - measured", "mm", 1.0)
        self._force = _Plot(gui, "Force at the tip", "N", 0.1)
        # Only a virtual lab knows where the tip really is.
        self._true_error = _Plot(gui, "Tip error, desired - simulated truth", "mm", 1.0, visible=False)

    def update(self, history: History) -> None:
        """Send the present curves."""
        since = time.monotonic() - self._newcomer
        if since < QUIET:
            if since > 0.5 * QUIET:
                self._refit()
            return
        self._refitted = False
        self._error.draw(history, lambda point: 1e3 * point.error)
        self._force.draw(history, lambda point: point.force)
        self._true_error.show(history.truth_known)
        if history.truth_known:
            self._true_error.draw(history, lambda point: 1e3 * point.true_error)

    async def _welcome(self, _client: viser.ClientHandle) -> None:
        self._newcomer = time.monotonic()

    def _refit(self) -> None:
        """Have the axes laid out anew.

        A plot that gets its width and new data in one go loses the numbers on its time axis: uPlot's `redraw`
        forgets the layout that `setSize` has asked for. Another size without new data brings them back.
        """
        if not self._refitted:
            self._refitted = True
            for plot in (self._error, self._force, self._true_error):
                plot.refit()


class _Plot:
    """x, y and z over the last seconds under a line that says what they are."""

    def __init__(self, gui: viser.GuiApi, title: str, unit: str, least: float, *, visible: bool = True) -> None:
        """The value axis shows +-`least` at least."""
        keys = "".join(
            f'<span style="color:{css(colour)};font-weight:700;margin-left:8px">{name}</span>'
            for name, colour in zip("xyz", AXES, strict=True)
        )
        self._title = gui.add_html(
            f'<div style="padding:4px 12px 0;font-size:13px;display:flex"><span style="flex:1">{title} [{unit}]</span>'
            f"<span>{keys}</span></div>",
            visible=visible,
        )
        self._plot = gui.add_uplot(
            (np.array([-SPAN, 0.0]), *(np.zeros(2) for _ in AXES)),
            (
                uplot.Series(label="t"),
                *(
                    uplot.Series(label=f"{name} [{unit}]", stroke=css(colour), width=1.5, points={"show": False})
                    for name, colour in zip("xyz", AXES, strict=True)
                ),
            ),
            scales={
                "x": uplot.Scale(time=False, range=(-SPAN, 0.0)),
                "y": uplot.Scale(range={end: _bound(sign * least) for end, sign in (("min", -1), ("max", 1))}),
            },
            axes=(
                uplot.Axis(
                    size=24.0,
                    gap=2.0,
                    label="time before now [s]",
                    labelSize=15.0,
                    labelGap=0.0,
                    font=FONT,
                    labelFont=FONT,
                ),
                uplot.Axis(size=36.0, gap=3.0, label=unit, labelSize=14.0, labelGap=0.0, font=FONT, labelFont=FONT),
            ),
            legend=uplot.Legend(show=False),
            height=HEIGHT,
            padding=(6, 12, 0, 0),
            visible=visible,
        )

    def show(self, visible: bool) -> None:
        self._title.visible = self._plot.visible = visible

    def refit(self) -> None:
        """Change the height by a pixel."""
        self._plot.height = HEIGHT + (self._plot.height == HEIGHT)

    def draw(self, history: History, value: Callable[[Point], Array]) -> None:
        """Send the points at which `value` (3,) is known."""
        points = [(point.time - history.now, *value(point)) for point in history.points]
        columns = np.array(points or [(np.nan,) * 4]).T
        shown = columns[:, np.isfinite(columns).all(axis=0)]
        if shown.shape[1] > 1:
            self._plot.data = tuple(shown)


def _bound(soft: float) -> dict[str, float]:
    return {"pad": 0.1, "soft": soft, "mode": 1}
