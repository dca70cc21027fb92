"""The gallery shows the names, titles and files of experiments as text, and its links lead to their folders."""

from html.parser import HTMLParser
from urllib.parse import unquote

from tests.tools.gallery import section

#: Name of an experiment's file, and of its figure: everything that a file name may contain.
HOSTILE = "a\"'><script>top.ran=1<!script> <img src=x onerror=top.ran=2> #?%41&amp;javascript:x"


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("href", "src") and value is not None]
        assert {name for name, _ in attrs} <= {"href", "src", "alt"}

    def handle_data(self, data: str) -> None:
        self.text += data


def test_hostile_names_titles_and_figures_are_text_and_links_to_the_own_folder() -> None:
    page = _Page()
    page.feed(section(HOSTILE, HOSTILE + "</section>", f"{HOSTILE}/{HOSTILE}.png"))

    assert page.tags == ["section", "h2", "p", "code", "a", "a", "img"]
    assert page.text.count(HOSTILE) == 2
    assert all(not set(link) & set("?#:\"'<> ") for link in page.links)
    assert [unquote(link) for link in page.links] == [
        f"{HOSTILE}/replay.html", f"{HOSTILE}/report.html", f"{HOSTILE}/{HOSTILE}.png",
    ]  # fmt: skip
