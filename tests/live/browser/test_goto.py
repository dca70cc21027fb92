"""Motion to a joint pose by numbers, from the tab Jog."""

import math

from playwright.sync_api import Page

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
