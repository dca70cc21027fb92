"""HTML elements of a report, which is one file without network access, for the screen and for printing."""

from collections.abc import Iterable, Sequence
from html import escape

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


def document(title: str, parts: Iterable[str]) -> str:
    """Return the HTML of a whole report page with its style sheet."""
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>{DOCUMENT_CSS}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def heading(text: str) -> str:
    """Return the HTML heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str, kind: str = "") -> str:
    """Return an HTML paragraph of plain text, which is escaped; `kind` is a CSS class."""
    return f"<p{f' class={kind!r}' if kind else ''}>{escape(text)}</p>"


def text_block(text: str) -> str:
    """Return an HTML element with preformatted text, e.g. a TOML file."""
    return f"<pre>{escape(text)}</pre>"


def picture(source: str, alt: str, title: str, caption: str) -> str:
    """Return an HTML figure with title and caption; `source` is the picture as a data URI."""
    return (
        f'<figure><img src="{source}" alt="{escape(alt, quote=True)}">'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
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
