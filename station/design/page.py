"""The page of a report about tubes: words, tables and figures, in the reports' own style."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path

import matplotlib

from station.report import document, rendered, style
from station.report.drawn import Drawn
from station.report.written import written

NAME = "report.html"
#: Said on every figure and page.
ORIGIN = "computed by the loaded model"
#: matplotlib's settings are the process's: pages are drawn one after the other.
_DRAWING = threading.Lock()


@contextmanager
def drawing() -> Iterator[None]:
    """Figures are made and written inside of this."""
    with _DRAWING, matplotlib.rc_context(style.SETTINGS):
        yield


def begin(title: str, sub: str, note: str) -> list[str]:
    """The top of a page."""
    return [f"<h1>{escape(title)}</h1>", document.paragraph(sub, "sub"), document.paragraph(note, "note")]


def shown(drawn: Drawn) -> str:
    """A figure on the page."""
    style.finish(drawn.figure, ORIGIN)
    return document.picture(rendered.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)


def write(folder: Path, title: str, parts: Iterable[str]) -> Path:
    """The page in `folder`.

    Raises:
        OSError: the folder does not take it.

    """
    return written(document.document(title, parts), folder / NAME)
