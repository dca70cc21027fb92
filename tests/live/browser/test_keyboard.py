"""A complete run with the keyboard only."""

from playwright.sync_api import Page

from tests.harness.chromium import press_until_sent
from tests.harness.serving import Served
from tests.harness.waiting import until


def tab_to(page: Page, text: str) -> None:
    """Press Tab until the focused element's name contains `text`; Tab passes over a button while it is disabled."""
    name = """() => {
      const here = document.activeElement;
      return here === document.body ? '' : here.getAttribute('aria-label') ?? here.innerText;
    }"""

    def reached() -> bool:
        page.keyboard.press("Tab")
        return text in page.evaluate(name)

    until(reached, f"no element '{text}' with Tab")


def test_run_is_chosen_started_stopped_and_reset_by_keyboard(page: Page, station: Served) -> None:
    tab_to(page, "Keep the tip where it is")
    page.keyboard.press("Enter")
    page.locator("#start", has_text="Load on the simulated tip").wait_for()
    tab_to(page, "duration")
    page.keyboard.press("Control+A")
    page.keyboard.type("45")

    def press(text: str) -> None:
        tab_to(page, text)
        page.keyboard.press("Enter")

    press_until_sent(page, lambda: press("Start motion"))
    status = station.wait_for(lambda s: s["state"] == "RUNNING")
    assert status["run"]["duration"] == 45.0
    page.locator("#state", has_text="RUNNING").wait_for()
    page.keyboard.press("Shift+Space")
    page.locator("#state", has_text="STOPPED").wait_for()
    press_until_sent(page, lambda: press("Reset"), "/api/reset")
    page.locator("#state", has_text="READY").wait_for()
