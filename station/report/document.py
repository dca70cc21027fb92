"""Parts of reports: pages of one HTML file without network access, for the screen and for printing; result folders."""

import base64
import csv
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from station.config.strict import ConfigError
from station.recording.run_folder import REPORT_FILE, write_atomically, write_json
from station.report import style

#: Resolution of PNG files [pixels per inch].
PNG_DPI = 200
#: Lock for drawing: matplotlib's settings are global to the process, so only one report may be drawn at a time.
DRAWING = threading.Lock()
DOCUMENT_CSS = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #15191d; background: #fff;
  max-width: 62rem; margin: 2rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .25rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #cdd3d9; padding-bottom: .2rem; }
p.note { background: #fff4d6; border-left: 4px solid #e69f00; padding: .5rem .8rem; margin: .8rem 0; }
p.result { font-size: 1.05rem; font-weight: 600; margin: .4rem 0; }
p.sub { color: #566270; margin: 0 0 .8rem; }
figure { margin: 1.4rem 0 2rem; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .88rem; color: #39424b; margin-top: .35rem; }
figcaption b { color: #15191d; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .88rem; margin: .6rem 0;
  width: 100%; }
th, td { text-align: left; padding: .22rem .6rem .22rem 0; border-bottom: 1px solid #e3e7ea; vertical-align: top; }
th.number, td.number { text-align: right; }
thead th { border-bottom: 2px solid #566270; }
tr.first td { border-top: 1px solid #566270; }
pre { font: .8rem/1.4 ui-monospace, "DejaVu Sans Mono", monospace; background: #f5f7f8; padding: .7rem;
  white-space: pre-wrap; overflow-wrap: anywhere; }
@page { size: A4; margin: 16mm; }
@media print {
  body { max-width: none; margin: 0; padding: 0; font-size: 10.5pt; }
  figure, tr, p.note { break-inside: avoid; }
  h2 { break-after: avoid; }
  pre { background: none; border: 1px solid #cdd3d9; }
}
"""


class ReportFigure(NamedTuple):
    """One figure of a report, with its title, caption and text alternative."""

    name: str  #: name of the figure's PNG and PDF files
    title: str
    caption: str  #: content of the figure and origin of its numbers
    alt: str  #: text alternative for readers who cannot see the figure
    figure: Figure


def write_page(folder: Path, title: str, parts: Iterable[str]) -> Path:
    """Write report.html into `folder` and return its path; figures among the `parts` are drawn while they are read.

    Raises:
        OSError: the file cannot be written.
    """
    with DRAWING, matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        body = "\n".join(parts)
    return write_atomically(
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>{DOCUMENT_CSS}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n",
        folder / REPORT_FILE,
    )


def write_results(
    folder: Path,
    title: str,
    parts: Iterable[str],
    numbers: Mapping[str, Any],
    tables: Mapping[str, Iterable[Sequence[Any]]] = {},
    texts: Mapping[str, str] = {},
) -> Path:
    """Write a folder of results, which is created if it does not exist, and return the path of its report.html.

    Args:
        folder: folder of the results.
        title: title of the page.
        parts: HTML elements of the page.
        numbers: JSON values by file name.
        tables: rows of CSV files, with their heads, by file name.
        texts: contents of other files, by file name.

    Raises:
        ConfigError: a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, rows in tables.items():
            text = StringIO()
            csv.writer(text).writerows(rows)
            write_atomically(text.getvalue(), folder / name)
        for name, content in texts.items():
            write_atomically(content, folder / name)
        for name, value in numbers.items():
            write_json(folder / name, value)
        return write_page(folder, title, parts)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None


def page_head(title: str, sub: str = "", note: str = "") -> Iterator[str]:
    """Yield the HTML elements of a page's head: title, subtitle and note."""
    yield f"<h1>{escape(title)}</h1>"
    if sub:
        yield paragraph(sub, "sub")
    if note:
        yield paragraph(note, "note")


def heading(text: str) -> str:
    """Return the HTML heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str, kind: str = "") -> str:
    """Return an HTML paragraph of plain text, which is escaped; `kind` is a CSS class."""
    return f"<p{f' class={kind!r}' if kind else ''}>{escape(text)}</p>"


def text_block(text: str) -> str:
    """Return an HTML element with preformatted text, e.g. a TOML file."""
    return f"<pre>{escape(text)}</pre>"


def picture(drawn: ReportFigure, origin: str, out: Path | None = None) -> str:
    """Return a figure as an HTML element with title and caption; the same data give the same text.

    Args:
        drawn: figure to show.
        origin: origin of the data, which the figure states at its bottom.
        out: folder for NAME.png and NAME.pdf; None: these files are not written.

    Raises:
        OSError: the files cannot be written.
    """
    style.finish(drawn.figure, origin)
    if out is not None:
        drawn.figure.savefig(out / f"{drawn.name}.png", dpi=PNG_DPI, metadata={"Description": drawn.alt})
        drawn.figure.savefig(out / f"{drawn.name}.pdf", metadata={"Title": drawn.title, "CreationDate": None})
    buffer = BytesIO()
    drawn.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    source = f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
    return (
        f'<figure><img src="{source}" alt="{escape(drawn.alt, quote=True)}">'
        f"<figcaption><b>{escape(drawn.title)}.</b> {escape(drawn.caption)}</figcaption></figure>"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> str:
    """Return an HTML table; the first `texts` columns are texts, the others numbers.

    If the first cell of a row repeats the first cell of the row above, it is left empty.
    """

    def cell(tag: str, column: int, text: str) -> str:
        return f"<{tag}{'' if column < texts else ' class=' + chr(34) + 'number' + chr(34)}>{escape(text)}</{tag}>"

    lines, before = [], None
    for row in rows:
        first = row[0] != before
        shown = row if first else ("", *row[1:])
        before = row[0]
        cells = "".join(cell("td", column, text) for column, text in enumerate(shown))
        lines.append(f"<tr{' class=' + chr(34) + 'first' + chr(34) if first else ''}>{cells}</tr>")
    top = "".join(cell("th", column, text) for column, text in enumerate(head))
    return f"<table><thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def section(title: str, note: str, head: Sequence[str], rows: Sequence[Sequence[str]], texts: int = 2) -> Iterator[str]:
    """Yield heading, note and table of a section; nothing without rows."""
    if rows:
        yield heading(title)
        if note:
            yield paragraph(note)
        yield table(head, rows, texts)


def terminal_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1, title: Text | None = None
) -> Table:
    """Return a table for the terminal; the first `texts` columns are texts, the others numbers."""
    shown = Table(title=title, title_style="")
    for column, label in enumerate(head):
        shown.add_column(label, justify="left" if column < texts else "right")
    for row in rows:
        shown.add_row(*row)
    return shown
