"""Figure of several cases over one time axis, with the width and font size of a journal's column."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.recording.run_outcome import known_force
from station.report import style
from station.report.document import DRAWING
from station.report.facts import dotted, origin
from station.report.run import NoRun, RecordedCase, RecordedRun, ReportError, read_run

FORMATS = (".pdf", ".svg")
#: Width of a journal's column and height of a diagram [inch], and size of all letters [pt].
COLUMN_INCH, DIAGRAM_INCH, LETTERS_PT = 88.0 / 25.4, 1.25, 8.0
SETTINGS: dict[Any, Any] = {
    **style.MATPLOTLIB_SETTINGS, "axes.linewidth": 0.6,
    **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize", "legend.fontsize"), LETTERS_PT),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), LETTERS_PT),
}  # fmt: skip
#: Largest number of differing settings in a line's label, and largest number of letters of a label.
MOST_NAMED, MOST_LETTERS = 2, 48


def write_overlay(chosen: Sequence[tuple[Path, str]], out: Path) -> str:
    """Draw tip error and force of several cases into the PDF or SVG file `out`, and return a caption for it.

    `chosen` has folders of runs and names of cases; an empty name chooses all cases of its run.

    Raises:
        NoRun, ConfigError, RecordingError: a run or case does not exist or cannot be read, or there is only one case.
        ReportError: the file name does not end with .pdf or .svg, or the file cannot be written.
    """
    if out.suffix not in FORMATS:
        raise ReportError(f"{out}: the file name must end with {' or '.join(FORMATS)}")
    runs = {folder: read_run(folder) for folder, _ in chosen}
    cases = [one for folder, name in chosen for one in _cases(runs[folder], name)]
    if len(cases) < 2:
        raise NoRun("a figure overlays at least two cases; name more runs or cases")
    with DRAWING, matplotlib.rc_context(SETTINGS):
        figure, caption = draw(cases)
        date = "CreationDate" if out.suffix == ".pdf" else "Date"  # no date: the same runs give the same file
        try:
            figure.savefig(out, metadata={"Title": caption, date: None})
        except OSError as error:
            raise ReportError(f"{out}: cannot write the figure: {error.strerror}") from None
    return f"{caption} Data: {', '.join(dict.fromkeys(origin(run) for run in runs.values()))}."


def _cases(run: RecordedRun, name: str) -> list[RecordedCase]:
    found = [case for case in run.cases if case.moved and name in ("", case.name)]
    if not found:
        names = ", ".join(case.name for case in run.cases) or "none"
        raise NoRun(f"{run.folder}: no case '{name}' with a motion; its cases: {names}")
    return found


def labels(cases: Sequence[RecordedCase]) -> list[str]:
    """Return a label for each case that names what differs: one or two settings, else the case, else the run."""
    settings = [{**dict(dotted("", case.settings)), "seed": str(case.metadata.get("seed", ""))} for case in cases]
    keys = dict.fromkeys(key for one in settings for key in one if key != "title")
    differing = [key for key in keys if len({one.get(key) for one in settings}) > 1]
    names = [
        ", ".join(f"{key.rsplit('.', 1)[-1]} {one.get(key, 'none').removesuffix('.0')}" for key in differing)
        for one in settings
    ]
    if not 0 < len(differing) <= MOST_NAMED:
        names = [str(case.metadata.get("case", case.name)) for case in cases]
    if len(set(names)) < len(cases):
        names = [f"{number}: {case.metadata.get('title', case.name)}" for number, case in enumerate(cases, 1)]
    return [name.replace("_", " ").replace('"', "")[:MOST_LETTERS] for name in names]


def draw(cases: Sequence[RecordedCase]) -> tuple[Figure, str]:
    """Return the figure of several cases and its caption; `SETTINGS` must be matplotlib's settings during the call."""
    unknown = sorted(set().union(*(case.force_unknown for case in cases)))
    diagrams: list[tuple[str, str, list[tuple[Array, Array]]]] = []
    if not any(case.sweeps for case in cases):
        against = " or ".join(dict.fromkeys("true" if case.truth_known else "measured" for case in cases))
        text = f"distance of the {against} tip from its desired position"
        diagrams.append(("tip error [mm]", text, [case.distance() for case in cases]))
    if len(unknown) < len(style.AXES):
        text = "estimated force at the tip" + (f" without {', '.join(unknown)}, unknown" if unknown else "")
        curves = [(case.time, known_force(case.of, "".join(unknown))) for case in cases]
        diagrams.append(("force [N]", text, curves))
    figure, panels = style.stacked([label for label, _, _ in diagrams])
    figure.set_size_inches(COLUMN_INCH, 0.4 + DIAGRAM_INCH * len(panels) + 0.16 * len(cases))
    start = max(case.counted_from for case in cases)
    for axes, (_, _, curves) in zip(panels, diagrams, strict=True):
        for number, ((times, values), label) in enumerate(zip(curves, labels(cases), strict=True)):
            style.draw(axes, times, values, style.series(number, label))
        axes.set_ylim(bottom=0.0)
        if start > 0.0:
            axes.axvspan(0.0, start, color=style.GREY, alpha=0.10, linewidth=0.0)
    style.legend(figure, panels, columns=1)
    style.finish(figure)
    caption = f"{'; '.join(text for _, text, _ in diagrams).capitalize()} over time. Settings in SI units."
    if start > 0.0:
        caption += f" Grey: at least in one case errors do not count before {start:g} s."
    return figure, caption
