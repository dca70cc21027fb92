"""A hand at the tip: a stand-in for a pad, whose dead man's button has to be held, and keys in their own field."""

import pytest
from playwright.sync_api import Page

from tests.harness.pad import LEFT, PAD
from tests.harness.serving import Served
from tests.harness.waiting import until

FAR = 0.002  #: that the tip has to go, beyond all noise [m]


@pytest.fixture
def page(page: Page) -> Page:
    page.locator("#tab-jog").click()
    page.locator("#hands fieldset").wait_for()
    return page


def pad(page: Page, axes: list[float], *, held: bool, obeys: bool = True) -> None:
    page.evaluate(PAD, {"axes": axes, "held": held, "obeys": obeys})


def says(page: Page, text: str) -> None:
    page.locator("#hands [role=status]", has_text=text).wait_for()


def along(station: Served) -> float:
    """Where the tip is along the straight tubes [m]."""
    return station.status()["tip_true"][2]


def moves(page: Page, station: Served) -> None:
    """With the left stick to the left and the button held the tip goes back along the tubes."""
    before = along(station)
    pad(page, LEFT, held=False)
    says(page, "Test Pad: hold a shoulder button")
    assert station.status()["state"] == "READY"  # a stick alone moves nothing
    pad(page, LEFT, held=True)
    station.wait_for(lambda status: status["tip_true"][2] < before - FAR)


def stands(station: Served) -> None:
    """The jog has ended and no other one begins: telemetry goes on, the joints do not."""
    station.wait_for(lambda status: status["state"] == "READY")
    seen: list[list[float]] = []
    station.wait_for(lambda s: seen.append(list(s["joints"].values())) or (len(seen) > 40 and seen[-1] == seen[-30]))
    assert station.status()["state"] == "READY"


def test_the_tip_moves_while_the_button_is_held_and_stops_when_it_is_let_go(page: Page, station: Served) -> None:
    moves(page, station)
    pad(page, LEFT, held=False)
    stands(station)
    says(page, "hold a shoulder button")


def test_it_stops_when_the_pad_is_unplugged_and_a_button_held_since_then_begins_nothing(
    page: Page, station: Served
) -> None:
    moves(page, station)
    page.evaluate(PAD, None)
    stands(station)
    says(page, "no pad is seen")
    pad(page, LEFT, held=True, obeys=False)
    says(page, "let go of its button, then press it again")
    stands(station)


@pytest.mark.parametrize("event", ["blur", "hide"])
def test_it_stops_when_the_page_is_left_and_does_not_go_on_by_itself(page: Page, station: Served, event: str) -> None:
    moves(page, station)
    pad(page, LEFT, held=True, obeys=False)
    if event == "blur":
        page.evaluate("() => window.dispatchEvent(new Event('blur'))")
    else:
        page.evaluate(
            """() => { Object.defineProperty(document, 'hidden', {value: true, configurable: true});
                       document.dispatchEvent(new Event('visibilitychange')); delete document.hidden; }"""
        )
    says(page, "let go of its button, then press it again")
    stands(station)


def test_what_a_stick_at_rest_shows_is_nothing_and_a_corner_is_no_faster(page: Page, station: Served) -> None:
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


def test_nothing_moves_for_who_is_not_operator_and_the_page_says_why(page: Page, station: Served) -> None:
    pad(page, LEFT, held=False)
    says(page, "hold a shoulder button")
    station.rest.post("/api/operator", json={"name": "Anna", "take_over": True})
    says(page, "'Anna' is operator")
    pad(page, LEFT, held=True)
    stands(station)
    station.rest.delete("/api/operator")
    says(page, "hold a shoulder button")  # held all the time, it begins nothing: who obeys lets go first


def test_keys_move_the_tip_while_they_are_held_in_their_field(page: Page, station: Served) -> None:
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
    stands(station)
