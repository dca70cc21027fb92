"""What an operator sees and presses beside the scene.

Whatever a browser sends is looked at again here and by the models of `station`: sliders and lists
bind nobody who writes to the socket. A refusal is shown to the one who asked and starts nothing.
"""

from collections.abc import Callable
from html import escape
from typing import Any

import viser

from core.controllers import STRATEGIES
from core.errors import CtrError
from station.config import check, preset_names
from station.desk import Desk
from station.experiments.experiment import ControllerFile, load_experiment
from station.lab.loads import ConstantLoad, Load, NoLoad, RaisedCosineLoad
from station.motions import CircleMotion, HoldMotion, SinusoidMotion, TipMotion
from station.states import State
from station.supervisor import Status
from web.health import health
from web.history import History
from web.inputs import Choice, Number
from web.legend import add_legend
from web.plots import Plots
from web.words import card

WIDTH = 380  #: of the panel [px]

#: The paper's letters and what the strategies are.
LETTERS = {
    "unloaded_jacobian": "(a) unloaded Jacobian",
    "loaded_jacobian": "(b) loaded Jacobian",
    "inner_loop": "(c) inner loop, Type I",
    "dual_layer": "(d) dual layer",
}
MOTIONS = ("hold", "sinusoid", "circle")
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
LOADS = ("none", "constant", "raised cosine")


class Panel:
    """Widgets of one station, shared by all browsers."""

    def __init__(self, server: viser.ViserServer, desk: Desk) -> None:
        self._desk = desk
        self._gui = gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", brand_color=(0, 114, 178))
        gui.set_panel_label("Operator")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)
        self._state = gui.add_html("")
        self.stop = gui.add_button(
            "STOP", color=(192, 28, 40), icon=viser.Icon.HAND_STOP, hint="stops every axis at once"
        )
        self.reset = gui.add_button(
            "Reset", color="gray", visible=False, hint="after a stop, a hold or a fault has been looked at"
        )
        tabs = gui.add_tab_group()
        with tabs.add_tab("Experiment"):
            self._build_experiment()
        with tabs.add_tab("Free motion"):
            self._build_motion()
        with tabs.add_tab("Health"):
            self._health = gui.add_html("")
        self._plots = Plots(server)
        add_legend(gui, desk.supervisor.robot)
        self.stop.on_click(self._guarded("STOP", desk.supervisor.stop))
        self.reset.on_click(self._guarded("Reset", desk.supervisor.reset))
        self.start_experiment.on_click(self._guarded("Experiment not started", self._start_experiment))
        self.start_motion.on_click(self._guarded("Motion not started", self._start_motion))

    def update(self, status: Status, history: History) -> None:
        """Texts, lights and plots for the present; ten times a second is plenty."""
        task = self._desk.supervisor.task
        self._state.content = card(status, task.duration if task else 0.0)
        ready = status.state is State.READY
        self.start_experiment.disabled = self.start_motion.disabled = not ready
        self.reset.visible = status.state in (State.HOLD, State.STOPPED, State.FAULT)
        self._health.content = health(status, history)
        self._plots.update(history)

    def _build_experiment(self) -> None:
        gui = self._gui
        self._experiments = {name: load_experiment(name) for name in preset_names("experiments")}
        names = tuple(self._experiments)
        first = self._experiments[names[0]]
        self.experiment = Choice(gui.add_dropdown("Experiment", names), "experiment", names)
        self.case = gui.add_dropdown("Case", tuple(case.name for case in first.cases))
        self._about = gui.add_html("")
        self.start_experiment = gui.add_button("Start experiment", icon=viser.Icon.PLAYER_PLAY, disabled=True)
        self.experiment.handle.on_update(self._guarded("Experiment", self._show_experiment))
        self._show_experiment()

    def _build_motion(self) -> None:
        gui = self._gui

        def number(
            name: str, unit: str, value: float, lower: float, upper: float, step: float, hint: str = ""
        ) -> Number:
            handle = gui.add_number(f"{name} [{unit}]", value, min=lower, max=upper, step=step, hint=hint or None)
            return Number(handle, name, unit, lower, upper)

        def choice(name: str, options: tuple[str, ...], value: str, hint: str | None = None) -> Choice:
            return Choice(gui.add_dropdown(name, options, initial_value=value, hint=hint), name, options)

        self.motion = choice("Motion", MOTIONS, "circle")
        self.axis = choice("Axis", tuple(AXES), "y", "direction of the sinusoid; axis of the circle")
        self.size = number("Amplitude", "mm", 10.0, 0.1, 50.0, 0.1, "of the sinusoid; radius of the circle")
        self.period = number("Period", "s", 20.0, 2.0, 600.0, 0.1)
        self.duration = number("Duration", "s", 60.0, 1.0, 3600.0, 1.0)
        self.strategy = choice("Strategy", tuple(LETTERS.get(name, name) for name in STRATEGIES), LETTERS["dual_layer"])
        self.gain = Number(
            gui.add_slider("k [1/s]", 0.5, 10.0, 0.1, 2.5, hint="K1 = K2 of the outer loop, dual layer only"),
            "k",
            "1/s",
            0.5,
            10.0,
        )
        self.feedforward = gui.add_checkbox("Feed-forward", True)
        self.load = choice("Load", LOADS, "raised cosine")
        self.force = number("Force", "N", 0.3, 0.0, 0.5, 0.01, "simulated weight along +x; the raised cosine's peak")
        self.load_period = number("Load period", "s", 20.0, 1.0, 600.0, 0.1)
        self.start_motion = gui.add_button("Start motion", icon=viser.Icon.PLAYER_PLAY, disabled=True)

    def _start_experiment(self) -> None:
        name = self.experiment.read()
        cases = tuple(case.name for case in self._experiments[name].cases)
        self._desk.start_experiment(name, Choice(self.case, f"case of {name}", cases).read())

    def _start_motion(self) -> None:
        duration = self.duration.read()
        self._desk.start_motion(self._motion(), self._controller(), self._load(), duration)

    def _motion(self) -> TipMotion:
        kind = self.motion.read()
        axis, size, period = AXES[self.axis.read()], 1e-3 * self.size.read(), self.period.read()
        match kind:
            case "hold":
                return HoldMotion()
            case "sinusoid":
                table = {"amplitude": size, "frequency": 1.0 / period, "direction": axis}
                return check(SinusoidMotion, table, "sinusoid")
            case _:
                return check(CircleMotion, {"radius": size, "period": period, "normal": axis}, "circle")

    def _controller(self) -> ControllerFile:
        shown = self.strategy.read()
        name = next(name for name in STRATEGIES if LETTERS.get(name, name) == shown)
        gain = self.gain.read()
        table = {"strategy": name, "k1": gain, "k2": gain, "feedforward": bool(self.feedforward.value)}
        return check(ControllerFile, table, "controller")

    def _load(self) -> Load:
        match self.load.read():
            case "none":
                return NoLoad()
            case "constant":
                return check(ConstantLoad, {"magnitude": self.force.read()}, "load")
            case _:
                return check(RaisedCosineLoad, {"peak": self.force.read(), "period": self.load_period.read()}, "load")

    def _show_experiment(self) -> None:
        experiment = self._experiments[self.experiment.read()]
        self.case.options = tuple(case.name for case in experiment.cases)
        longest = max(case.file.duration for case in experiment.cases)
        self._about.content = (
            '<div style="padding:2px 12px 8px;font-size:12px;line-height:1.35;color:#495057">'
            f"{escape(experiment.title)}. {longest:g} s, after the way to the start pose.</div>"
        )

    def _guarded(self, title: str, act: Callable[[], object]) -> Callable[[viser.GuiEvent[Any]], None]:
        """`act` as a callback that shows a refusal to the one who asked."""

        def callback(event: viser.GuiEvent[Any]) -> None:
            try:
                act()
            except CtrError as error:
                if event.client is not None:
                    event.client.add_notification(title, str(error), color="red", auto_close_seconds=10.0)

        return callback
