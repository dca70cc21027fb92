"""Jogs of the tip with keys, and with a simulated gamepad whose dead man's button must be pressed."""

import pytest
from playwright.sync_api import Page

from tests.harness.chromium import open_tab
from tests.harness.pad import LEFT, PAD
from tests.harness.serving import Served
from tests.harness.waiting import until

FAR = 0.002  #: required motion of the tip, larger than all noise [m]


@pytest.fixture
def page(page: Page) -> Page:
    open_tab(page, "jog")
    page.locator("#hands fieldset").wait_for()
    return page


def pad(page: Page, axes: list[float], *, held: bool, obeys: bool = True) -> None:
    page.evaluate(PAD, {"axes": axes, "held": held, "obeys": obeys})


def says(page: Page, text: str) -> None:
    page.locator("#hands [role=status]", has_text=text).wait_for()


def along(station: Served) -> float:
    """Return the true position of the tip along the straight tubes [m]."""
    return station.status()["tip_true"][2]


def moves(page: Page, station: Served) -> None:
    """Move the tip back along the tubes by the left stick (to the left) with the button pressed."""
    before = along(station)
    pad(page, LEFT, held=False)
    says(page, "Test Pad: hold a shoulder button")
    assert station.status()["state"] == "READY"  # the stick without the button moves nothing
    pad(page, LEFT, held=True)
    station.wait_for(lambda status: status["tip_true"][2] < before - FAR)


def wait_until_at_rest(station: Served) -> None:
    """Check that the jog has ended and that no other jog starts: telemetry continues and the joints rest."""
    station.wait_for(lambda status: status["state"] == "READY")
    station.rest_of_joints()
    assert station.status()["state"] == "READY"


def test_gamepad_moves_the_tip_while_its_button_is_held_and_stops_it_on_release(page: Page, station: Served) -> None:
    moves(page, station)
    pad(page, LEFT, held=False)
    wait_until_at_rest(station)
    says(page, "hold a shoulder button")


def test_tip_stops_when_the_gamepad_is_unplugged_and_its_held_button_has_no_later_effect(
    page: Page, station: Served
) -> None:
    moves(page, station)
    page.evaluate(PAD, None)
    wait_until_at_rest(station)
    says(page, "no gamepad detected")
    pad(page, LEFT, held=True, obeys=False)
    says(page, "release its button, then press it again")
    wait_until_at_rest(station)


@pytest.mark.parametrize("event", ["blur", "hide"])
def test_gamepad_jog_stops_when_the_page_is_left_and_does_not_resume_by_itself(
    page: Page, station: Served, event: str
) -> None:
    moves(page, station)
    pad(page, LEFT, held=True, obeys=False)
    if event == "blur":
        page.evaluate("() => window.dispatchEvent(new Event('blur'))")
    else:
        page.evaluate(
            """() => { Object.defineProperty(document, 'hidden', {value: true, configurable: true});
                       document.dispatchEvent(new Event('visibilitychange')); delete document.hidden; }"""
        )
    says(page, "release its button, then press it again")
    wait_until_at_rest(station)


def test_gamepad_stick_has_a_dead_zone_and_is_not_faster_in_its_corner(page: Page, station: Served) -> None:
    pad(page, [0.1, -0.1, 0.0, 0.09], held=False)
    says(page, "hold a shoulder button")
    speeds = "() => [...document.querySelectorAll('.axes output')].map((one) => parseFloat(one.textContent))"
    page.wait_for_function(f"() => ({speeds})().every((speed) => speed === 0)")
    pad(page, [-1.0, 0.0, 0.0, 0.0], held=False)
    page.wait_for_function(f"() => Math.hypot(...({speeds})()) > 0")
    straight = page.evaluate(speeds)
    assert straight == [0.0, 0.0, pytest.approx(-3.0, abs=0.1)]
    pad(page, [-1.0, 1.0, 0.0, -1.0], held=False)
    page.wait_for_function(f"() => ({speeds})().every((speed) => speed !== 0)")
    x, y, z = page.evaluate(speeds)
    assert (x, y, z) == pytest.approx((1.7, 1.7, -1.7), abs=0.1)


def test_gamepad_has_no_effect_without_control_and_the_page_shows_the_reason(page: Page, station: Served) -> None:
    pad(page, LEFT, held=False)
    says(page, "hold a shoulder button")
    station.rest.post("/api/operator", json={"name": "Anna", "take_over": True})
    says(page, "'Anna' is operator")
    pad(page, LEFT, held=True, obeys=False)
    wait_until_at_rest(station)
    station.rest.delete("/api/operator")
    # A button that was pressed before has no effect until the user releases it.
    says(page, "release its button, then press it again")
    wait_until_at_rest(station)
    pad(page, LEFT, held=False)
    says(page, "hold a shoulder button")


def test_arrow_keys_move_the_tip_while_they_are_held_in_the_jog_field(page: Page, station: Served) -> None:
    page.evaluate(PAD, None)
    field = page.get_by_role("application", name="move the tip by keys")
    before = along(station)
    field.focus()
    page.get_by_text("These keys move the tip").wait_for()

    def moved() -> bool:
        if not page.locator(".keys.held").count():
            page.keyboard.up("ArrowLeft")
            page.keyboard.down("ArrowLeft")
        return along(station) < before - FAR

    until(moved)
    page.keyboard.up("ArrowLeft")
    wait_until_at_rest(station)
