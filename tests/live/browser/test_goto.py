"""Motion to a joint pose by numbers, from the tab Jog."""

import math

from playwright.sync_api import Page, expect

from tests.harness.chromium import open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served


def arrives(station: Served, title: str, degrees: float) -> None:
    """Wait until the inner rotation is at `degrees` and the station is READY; the start of the motion may be missed."""
    status = station.wait_for(
        lambda s: s["state"] == "READY" and abs(math.degrees(s["joints"]["inner_rotation"]) - degrees) < 0.1
    )
    assert status["run"]["title"] == title


def test_robot_goes_to_a_pose_after_confirmation_and_back_to_the_working_pose(page: Page, station: Served) -> None:
    open_tab(page, "jog")
    page.get_by_label("inner rotation to go to").fill("84")

    def go_there() -> None:
        question = press_until_asked(page, page.get_by_role("button", name="Go there").click)
        question.get_by_text("inner rotation 84 °").wait_for()
        assert station.status()["state"] == "READY"  # nothing moves before the user confirms
        question.get_by_role("button", name="Go").click()

    press_until_sent(page, go_there, "/api/goto")
    arrives(station, "to a pose", 84.0)

    def go_to_working_pose() -> None:
        question = press_until_asked(page, page.get_by_role("button", name="Go to the working pose").click)
        question.get_by_text("inner rotation 90 °").wait_for()
        question.get_by_role("button", name="Go").click()

    press_until_sent(page, go_to_working_pose, "/api/goto")
    arrives(station, "to the working pose", 90.0)


def test_each_press_in_step_mode_moves_a_joint_or_the_tip_by_one_step(page: Page, station: Served) -> None:
    open_tab(page, "jog")
    page.get_by_label("turn", exact=True).select_option("by 1 ° each press")
    plus = page.get_by_role("button", name="inner rotation plus: one step")
    press_until_sent(page, plus.click, "/api/goto")
    arrives(station, "by a step of inner_rotation", 91.0)
    page.locator("#state", has_text="READY").wait_for()
    plus.press("Enter")  # the button has kept the focus
    arrives(station, "by a step of inner_rotation", 92.0)
    page.get_by_label("turn", exact=True).select_option("while held")

    page.get_by_label("move", exact=True).select_option("by 5 mm each press")
    before = station.status()["tip_true"]
    press_until_sent(page, page.get_by_role("button", name="z minus: one step").click, "/api/goto")
    station.wait_for(lambda s: s["state"] == "READY" and s["tip_true"][2] < before[2] - 4.5e-3)
    after = station.status()["tip_true"]
    assert [round(1e3 * (b - a)) for a, b in zip(before, after, strict=True)] == [0, 0, -5]
    page.get_by_label("move", exact=True).select_option("while held")


def test_tip_goes_to_a_place_and_a_place_out_of_reach_is_refused_at_its_field(page: Page, station: Served) -> None:
    station.ready()
    open_tab(page, "jog")
    page.get_by_role("button", name="Fill in the present place").click()
    fields = [page.get_by_label(f"place {axis}", exact=True) for axis in "xyz"]
    before = [float(field.input_value()) for field in fields]
    measured = station.status()["tip_measured"]
    assert max(abs(shown - 1e3 * x) for shown, x in zip(before, measured, strict=True)) < 0.5  # mm

    def go_there() -> None:
        question = press_until_asked(page, page.get_by_role("button", name="Send the tip there").click)
        question.get_by_role("button", name="Go").click()

    for goal in ([before[0], before[1] + 8.0, before[2] - 5.0], before):
        for field, value in zip(fields, goal, strict=True):
            field.fill(f"{value:.1f}")
        press_until_sent(page, go_there, "/api/goto")
        station.wait_for(
            lambda s, goal=goal: (
                s["state"] == "READY"
                and s["run"]["title"] == "to a place"
                and max(abs(1e3 * x - wanted) for x, wanted in zip(s["tip_true"], goal, strict=True)) < 1.5
            )
        )

    fields[2].fill("900")
    press_until_sent(page, go_there, "/api/goto")
    refused = page.locator("#jog .refused")
    expect(refused).to_contain_text("travel of")
    expect(fields[2]).to_have_value("900")
    assert station.status()["state"] == "READY"
    page.get_by_role("button", name="Fill in the present place").click()
    fields[2].press("ArrowUp")  # a change removes the refusal
    expect(refused).to_have_count(0)
