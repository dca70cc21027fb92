"""The report of a run: one HTML file with everything in it."""

import threading
from collections.abc import Iterator
from pathlib import Path

import matplotlib

from station.experiments.sweep_output import SWEEP
from station.report import document, facts, rendered, spread, style
from station.report.drawn import Drawn
from station.report.figures import figures
from station.report.run import read_run
from station.report.written import ReportError, written

NAME = "report.html"
#: matplotlib's settings are the process's: reports are drawn one after the other.
_DRAWING = threading.Lock()


def write_report(folder: Path, out: Path | None = None) -> Path:
    """Make the report of the run, or of the sweep, in `folder`.

    Args:
        folder: of the run.
        out: where report.html and PNG and PDF of every figure go; None: report.html alone, into the run's folder.

    Returns:
        The HTML file.

    Raises:
        NoRun: there is no run in the folder.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the report cannot be written.
    """
    with _DRAWING, matplotlib.rc_context(style.SETTINGS):
        try:
            if out is not None:
                out.mkdir(parents=True, exist_ok=True)
            is_sweep = (folder / SWEEP).is_file()
            page = document.document(f"{folder.name}: report", (_sweep if is_sweep else _run)(folder, out))
            return written(page, (out or folder) / NAME)
        except OSError as error:
            raise ReportError(f"{out or folder}: cannot write the report there: {error.strerror}") from None


def _run(folder: Path, out: Path | None) -> Iterator[str]:
    run = read_run(folder)
    yield from facts.head(run)
    yield from facts.result(run)
    yield from facts.direction_table(run)
    yield from facts.beside_table(run)
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


def _shown(drawn: Drawn, origin: str, out: Path | None) -> str:
    style.finish(drawn.figure, origin)
    if out is not None:
        rendered.write_files(drawn, out)
    return document.picture(rendered.data_uri(drawn), drawn.alt, drawn.title, drawn.caption)
