"""Report of a run or a sweep as one self-contained HTML file, with the figures of its experiment."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from station.recording.history import SWEEP_FILE
from station.regular_file import is_regular
from station.report import (
    camera_figures,
    document,
    facts,
    force_figures,
    load_figures,
    loop_figures,
    sweep,
    tip_figures,
)
from station.report.document import ReportFigure
from station.report.run import RecordedRun, ReportError, read_run

#: Functions that draw the figures, by the name of the experiment; any other experiment gets the overview.
FIGURES_BY_EXPERIMENT: Mapping[str, tuple[Callable[[RecordedRun], Iterator[ReportFigure]], ...]] = {
    "fig3": (tip_figures.strategies,),
    "fig4": (load_figures.deflection, load_figures.deflection_rate),
    "fig6": (tip_figures.models,),
    "fig7": (tip_figures.tracking,),
    "fig8": (tip_figures.tracking, load_figures.deflection_rate),
    "fig10": (tip_figures.tracking, load_figures.paper_force, load_figures.deflection_rate),
    "step_response": (loop_figures.steps,),
    "load_rate": (load_figures.load_rate,),
    "follow": (tip_figures.follow,),
}


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
    parts = _sweep if is_regular(folder / SWEEP_FILE) else _run
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        return document.write_page(out or folder, f"{folder.name}: report", parts(folder, out))
    except OSError as error:
        raise ReportError(f"{out or folder}: cannot write the report: {error.strerror}") from None


def figures(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield all figures of a run's report."""
    chosen = FIGURES_BY_EXPERIMENT.get(run.experiment, (tip_figures.overview,))
    for draw in (force_figures.presses, *chosen, loop_figures.timing):
        yield from draw(run)


def _run(folder: Path, out: Path | None) -> Iterator[str]:
    run = read_run(folder)
    yield from facts.head(run)
    yield from facts.result(run)
    yield document.heading("Figures")
    if not run.cases:
        yield document.paragraph("Nothing was recorded.")
    for drawn in figures(run):
        yield document.picture(drawn, facts.origin(run), out)
    yield from camera_figures.camera_pictures(run, facts.origin(run), out)
    yield from facts.line_table(run)
    yield from facts.configuration(run)


def _sweep(folder: Path, out: Path | None) -> Iterator[str]:
    found, parts = sweep.sweep_parts(folder)
    yield from parts
    for drawn in sweep.draw(found):
        yield document.picture(drawn, "simulated bench", out)
    yield from facts.source(folder)
