"""The panel under hands that do not keep to its sliders: real messages through viser's socket."""

import re
from collections.abc import Iterator
from typing import Any

import pytest

from core.controllers import STRATEGIES
from station.config import preset_names
from station.loop import Phase
from station.ring import Timing
from station.states import State
from station.supervisor import Status
from tests.viewing import Browser, Viewed, browser, viewing, wait_for
from web.panel import LETTERS, Panel
from web.words import card, words

NO_TIMING = Timing(0, 0, {}, {}, "")


@pytest.fixture(scope="module")
def module_viewed() -> Iterator[Viewed]:
    with viewing() as viewed, browser(viewed.server) as first:
        # viser keeps the thread of its first callback: it must not look like a test's leftover.
        first.press(viewed.view._panel.reset)
        assert "reset" in first.refusal()
        yield viewed


@pytest.fixture
def viewed(module_viewed: Viewed) -> Viewed:
    module_viewed.make_ready()
    return module_viewed


@pytest.fixture
def panel(viewed: Viewed) -> Panel:
    return viewed.view._panel


@pytest.fixture
def person(viewed: Viewed) -> Iterator[Browser]:
    with browser(viewed.server) as person:
        yield person


def widget(panel: Panel, name: str) -> Any:
    found = getattr(panel, name)
    return getattr(found, "handle", found)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("size", float("nan")),
        ("size", 9999.0),
        ("size", -1.0),
        ("period", 0.0),
        ("period", float("inf")),
        ("duration", 1e308),
        ("gain", float("nan")),
        ("gain", 9999.0),
        ("force", 9999.0),
        ("force", float("-inf")),
        ("load_period", 0.0),
        ("motion", "dance"),
        ("axis", "w"),
        ("strategy", "(z) magic"),
        ("load", "<b>elephant</b>"),
    ],
)
def test_a_forged_value_is_refused_by_name_and_nothing_starts(
    viewed: Viewed, panel: Panel, person: Browser, name: str, value: Any
) -> None:
    handle = widget(panel, name)
    good = handle.value
    run = viewed.supervisor.status().run
    try:
        person.set(handle, value)
        person.press(panel.start_motion)
        said = person.refusal()
    finally:
        handle.value = good
    assert getattr(panel, name).name in said
    assert str(value) in said
    assert viewed.supervisor.status().run == run
    assert viewed.supervisor.status().state is State.READY


@pytest.mark.parametrize(("name", "value"), [("experiment", "../../etc/passwd"), ("case", "nonsense")])
def test_a_forged_experiment_is_refused(viewed: Viewed, panel: Panel, person: Browser, name: str, value: str) -> None:
    handle = widget(panel, name)
    good = handle.value
    try:
        person.set(handle, value)
        if name == "experiment":
            assert value in person.refusal()
        person.press(panel.start_experiment)
        assert value in person.refusal()
    finally:
        handle.value = good
    assert viewed.supervisor.status().state is State.READY


def test_a_motion_starts_as_set_and_stop_stops_it(viewed: Viewed, panel: Panel, person: Browser) -> None:
    person.set(panel.motion.handle, "sinusoid")
    person.set(panel.axis.handle, "z")
    person.set(panel.size.handle, 5)
    person.set(panel.gain.handle, 4.0)
    person.press(panel.start_motion)
    wait_for(lambda: viewed.supervisor.status().state is State.RUNNING)
    wait_for(lambda: panel.start_motion.disabled and panel.start_experiment.disabled)
    task = viewed.supervisor.task
    assert task is not None
    outer: Any = task.controller.strategy.outer
    assert (outer.k1, outer.k2, outer.feedforward) == (4.0, 4.0, True)
    quarter: Any = task.orders.at(0.25 * panel.period.read())
    assert quarter.position == pytest.approx((0.0, 0.0, 0.005))
    # A second start is refused to the one who asked.
    person.press(panel.start_motion)
    assert "RUNNING" in person.refusal()
    person.press(panel.stop)
    wait_for(lambda: viewed.supervisor.status().state is State.STOPPED)
    wait_for(lambda: panel.reset.visible)
    person.press(panel.reset)
    wait_for(lambda: viewed.supervisor.status().state is State.READY)
    wait_for(lambda: not panel.reset.visible)


def test_an_experiment_starts_with_the_case_that_is_shown(viewed: Viewed, panel: Panel, person: Browser) -> None:
    person.set(panel.experiment.handle, "fig8")
    wait_for(lambda: panel.case.options[:2] == ("regulation", "lift_and_drop"))
    wait_for(lambda: "dual-layer" in panel._about.content)
    person.set(panel.case, "lift_and_drop")
    person.press(panel.start_experiment)
    wait_for(lambda: viewed.supervisor.status().title == "fig8, case lift_and_drop")
    wait_for(lambda: "fig8, case lift_and_drop" in panel._state.content)


def test_stop_is_there_whatever_the_state(panel: Panel) -> None:
    assert panel.stop.visible
    assert not panel.stop.disabled


def test_every_strategy_has_its_letter_and_every_preset_is_offered(panel: Panel) -> None:
    assert set(LETTERS) >= set(STRATEGIES)
    assert panel.experiment.options == tuple(preset_names("experiments"))


def test_health_says_what_is_punctual_and_what_answers(viewed: Viewed, panel: Panel) -> None:
    wait_for(lambda: panel._health.content.count(" ok ") == 3)
    text = re.sub(r"<[^>]*>", " ", panel._health.content)
    for word in ("Stages", "Tracker", "Force sensors", "p50 [µs]", "p99 [µs]", "max [µs]", "missed", "normal priority"):
        assert word in text


# ---- words


def status(state: State, **changes: Any) -> Status:
    plain = Status(state, "", "", "", Phase.NONE, 0.0, 0.01, NO_TIMING, {})
    return plain._replace(**changes)


@pytest.mark.parametrize("state", State)
def test_every_state_has_words(state: State) -> None:
    said = words(status(state))
    assert said.state == state.name
    assert said.what


@pytest.mark.parametrize("state", [State.HOLD, State.STOPPED, State.FAULT])
def test_a_latched_state_says_why_and_that_reset_is_next(state: State) -> None:
    said = words(status(state, cause="the tracker is gone"))
    assert said.what == "the tracker is gone"
    assert "Reset" in said.next


def test_old_telemetry_is_never_called_ready() -> None:
    assert words(status(State.READY, age=2.0)).state == "STALE"
    assert words(status(State.RUNNING, age=2.0)).state == "STALE"
    assert words(status(State.FAULT, age=2.0)).state == "FAULT"


def test_what_others_wrote_is_not_markup() -> None:
    html = card(status(State.FAULT, cause="<img src=x>", title="<script>"), 10.0)
    assert "<img" not in html
    assert "<script" not in html


def test_time_left_is_shown_while_moving_only() -> None:
    moving = status(State.RUNNING, phase=Phase.MOVING, progress=0.25)
    assert "2:30 left of 3:20" in card(moving, 200.0)
    assert " left of " not in card(moving._replace(state=State.FAULT), 200.0)
    assert " left of " not in card(moving._replace(phase=Phase.SETTLING), 200.0)
