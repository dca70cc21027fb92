"""Parts of a report's page, for tests."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Pictures, cells, paragraphs and texts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pictures: list[dict[str, str]] = []
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.paragraphs: list[str] = []
        self.captions: list[str] = []
        self.text = ""
        self._in, self._texts = "", list[str]()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._in = tag
        if tag == "img":
            self.pictures.append(dict(attrs))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag in ("p", "figcaption"):
            self._texts = self.paragraphs if tag == "p" else self.captions
            self._texts.append("")

    def handle_data(self, data):
        if self._in in ("td", "th") and self.rows:
            self.rows[-1][-1] += data
        if self._in in ("p", "figcaption", "b") and self._texts:
            self._texts[-1] += data
        if self._in != "style":
            self.text += data
