"""Report of a run as one self-contained HTML file."""

import threading
from collections.abc import Iterator
from pathlib import Path

import matplotlib

from station.experiments.sweep_output import SWEEP_FILE
from station.report import document, facts, spread, style, templates
from station.report.atomic_write import ReportError, write_atomically
from station.report.figure import ReportFigure
from station.report.figures import figures
from station.report.run import read_run

REPORT_FILE = "report.html"
#: Lock for drawing: matplotlib's settings are global to the process, so only one report may be drawn at a time.
_DRAWING = threading.Lock()


def write_report(folder: Path, out: Path | None = None) -> Path:
    """Write the report of the run or sweep in `folder`.

    Args:
        folder: folder of the run.
        out: folder for report.html and for PNG and PDF files of every figure; None: write only report.html, into the
            run's folder.

    Returns:
        Path of the HTML file of the report.

    Raises:
        NoRun: the folder has no run.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the report cannot be written.
    """
    with _DRAWING, matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        try:
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
            is_sweep = (folder / SWEEP_FILE).is_file()
            page = document.document(f"{folder.name}: report", (_sweep if is_sweep else _run)(folder, out))
            return write_atomically(page, (out or folder) / REPORT_FILE)
        except OSError as error:
            raise ReportError(f"{out or folder}: cannot write the report: {error.strerror}") from None


def _run(folder: Path, out: Path | None) -> Iterator[str]:
    run = read_run(folder)
    yield from facts.head(run)
    yield from facts.result(run)
    yield from facts.direction_table(run)
    yield from facts.paper_table(run)
    yield document.heading("Figures")
    if not run.cases:
        yield document.paragraph("Nothing was recorded.")
    for drawn in figures(run):
        yield _shown(drawn, facts.origin(run), out)
    yield from facts.bound_table(run)
    yield from facts.line_table(run)
    yield from facts.configuration(run)


def _sweep(folder: Path, out: Path | None) -> Iterator[str]:
    sweep, parts = spread.sweep_parts(folder)
    yield from parts
    for drawn in spread.draw(sweep):
        yield _shown(drawn, "simulated bench", out)
    yield from facts.source(folder)


def _shown(drawn: ReportFigure, origin: str, out: Path | None) -> str:
    style.finish(drawn.figure, origin)
    if out is not None:
        templates.write_files(drawn, out)
    return document.picture(templates.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)
