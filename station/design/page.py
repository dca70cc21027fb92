"""HTML page of a report about tubes: texts, tables and figures in the style of the run reports."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path

import matplotlib

from station.report import document, style, templates
from station.report.atomic_write import write_atomically
from station.report.figure import ReportFigure

REPORT_FILE = "report.html"
#: Label on every figure: origin of its data.
ORIGIN_LABEL = "computed by the loaded model"
#: Lock for drawing: matplotlib's settings are global to the process, so only one page may be drawn at a time.
_DRAWING = threading.Lock()


@contextmanager
def drawing() -> Iterator[None]:
    """Apply the station's matplotlib settings; figures are created and written inside this context."""
    with _DRAWING, matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


def page_head(title: str, sub: str, note: str) -> list[str]:
    """Return the HTML elements of a page's head: title, subtitle and note."""
    return [f"<h1>{escape(title)}</h1>", document.paragraph(sub, "sub"), document.paragraph(note, "note")]


def figure_html(drawn: ReportFigure) -> str:
    """Return a figure as an HTML element with title and caption."""
    style.finish(drawn.figure, ORIGIN_LABEL)
    return document.picture(templates.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)


def write_page(folder: Path, title: str, parts: Iterable[str]) -> Path:
    """Write the page into `folder` and return its path.

    Raises:
        OSError: the file cannot be written.

    """
    return write_atomically(document.document(title, parts), folder / REPORT_FILE)
