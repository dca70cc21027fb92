"""Number fields send what they show: with a decimal comma or point; everything else is refused below the field."""

import re
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.harness.chromium import bare_page, open_tab, press_until_asked
from tests.harness.serving import Served

#: Entries that are accepted, and how the field then shows them.
ACCEPTED = {
    "84": "84", "84.5": "84.5", "84,5": "84.5", ",5": "0.5", "5,": "5", "+5": "5", "-5": "-5", "\u22125": "-5",
    " 7 ": "7", "1e1": "10", "007": "7", "-0": "0", "1,234": "1.234",
}  # fmt: skip
REFUSED = [
    "1.234,5", "1,234.5", "5 mm", "5°", "1 000", "--5", "5-", "e5", "0x10", "½", "٣", "NaN", "Infinity", "1e999", "abc",
    "84;5", "84. 5", " ", ".", "-", "1e", "8e4",
]  # fmt: skip


@pytest.fixture(scope="module", params=["en-GB", "de-DE"])
def pose_page(request: pytest.FixtureRequest, running: Served, browser: Browser) -> Iterator[Page]:
    """The tab Jog in a browser of this language."""
    running.ready()
    with bare_page(browser, running, locale=request.param) as page:
        open_tab(page, "jog")
        yield page


def typed(field: Locator, text: str) -> None:
    field.fill("")
    field.press_sequentially(text)


def pasted(field: Locator, text: str) -> None:
    field.fill("")
    field.focus()
    field.page.keyboard.insert_text(text)


def filled(field: Locator, text: str) -> None:
    """Enter a text as autofill does."""
    field.fill(text)


@pytest.mark.parametrize("enter", [typed, pasted, filled])
def test_field_shows_the_number_that_it_sends_or_refuses_the_entry(
    pose_page: Page, enter: Callable[[Locator, str], None]
) -> None:
    field, refusal = pose_page.get_by_label("inner rotation to go to"), pose_page.locator("#jog .refused")
    for text, shown in ACCEPTED.items():
        enter(field, text)
        field.blur()
        expect(field).to_have_value(shown)
        expect(refusal).to_have_count(0)
        assert field.evaluate("field => [field.number, field.validity.valid]") == [float(shown), True]
    for text in REFUSED:
        enter(field, text)
        field.blur()
        expect(field).to_have_value(text)
        reason = {"8e4": "80000 is too large", " ": "Spaces are no number"}.get(text, f"“{text}” is not a number")
        expect(refusal).to_contain_text(reason)
        expect(field).to_have_attribute("aria-invalid", "true")
        assert field.evaluate("field => field.matches(':invalid')")


def test_refused_entry_starts_nothing_and_a_comma_moves_to_the_shown_pose(pose_page: Page) -> None:
    field = pose_page.get_by_label("inner rotation to go to")
    go = pose_page.get_by_role("button", name="Go there…")
    field.fill(1_000_000 * "1" + "x")  # a regular expression needs hours for this text
    field.blur()
    expect(pose_page.locator("#jog .refused")).to_have_text(re.compile("^“1{60}…” is not a number"))
    field.fill("84.5 degrees")
    sent = """field => {
      let sent = false;
      field.form.addEventListener("submit", () => { sent = true; }, { once: true });
      field.form.requestSubmit();
      return sent;
    }"""
    assert not field.evaluate(sent)
    pose_page.locator("#jog .refused", has_text="“84.5 degrees” is not a number").wait_for()

    field.fill("84,5")
    question = press_until_asked(pose_page, go.click)
    expect(question).to_contain_text("inner rotation 84.5 °")
    question.get_by_role("button", name="Cancel").click()


def test_arrow_keys_change_a_number_within_its_bounds(pose_page: Page) -> None:
    field = pose_page.get_by_label("inner rotation to go to")
    largest = field.evaluate("field => field.bounds.max")
    field.fill(str(largest - 0.5))
    for expected in (largest, largest, largest - 1):
        field.press("ArrowUp" if expected == largest else "ArrowDown")
        expect(field).to_have_value(f"{expected:g}")
