"""Texts and tables of a run's report: outcome, errors, the paper's numbers, serial line, configuration and versions.

The errors come from the run's summary, in millimetres, from the time `counted_from_s` on. `measured` errors compare the
desired tip with the tracker, as in the paper; `true` errors compare it with the simulated real robot (plant).
"""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from station.recording.run_folder import EXPERIMENT_FILE
from station.recording.run_outcome import case_outcomes, evaluation_note
from station.report import document
from station.report.run import RecordedRun
from station.report.style import AXES


class ComparisonFigure(NamedTuple):
    """One number that the paper reports, with the measured and the true number of a run."""

    case: str
    quantity: str
    paper: float
    measured: float
    true: float | None  #: true number; None if the recording has no ground truth

    @property
    def ratio(self) -> float:
        """Ratio of the measured number to the paper's."""
        return self.measured / self.paper


class ComparedErrors(NamedTuple):
    """One kind of tip error of one case (e.g. largest true error) in x, y and z."""

    case: str
    kind: str
    values: tuple[float, float, float]


def paper_comparison(run: RecordedRun) -> Iterator[ComparisonFigure]:
    """Yield every number that the paper reports for a case of this run, with the numbers of the run."""
    for name, numbers in run.summary.get("cases", {}).items():
        true = numbers.get("true_max_abs_error_mm")
        for axis, paper in run.paper(name, "max_abs_error_mm").items():
            if "max_abs_error_mm" in numbers:
                at = AXES.index(axis)
                measured = numbers["max_abs_error_mm"][at]
                yield ComparisonFigure(name, f"largest |E| in {axis}", paper, measured, true[at] if true else None)
        for model, paper in run.paper(name, "model_error_mm").items():
            if model in numbers.get("model_error_mm", {}):
                measured = numbers["model_error_mm"][model]
                yield ComparisonFigure(name, f"mean distance of the {model} model", paper, measured, None)


def all_errors(run: RecordedRun) -> Iterator[ComparedErrors]:
    """Yield the largest and RMS errors of every case."""
    for name, numbers in run.summary.get("cases", {}).items():
        for kind, key in (("largest |E|", "max_abs_error_mm"), ("RMS E", "rms_error_mm")):
            for against, prefix in (("measured", ""), ("true", "true_")):
                if prefix + key in numbers:
                    x, y, z = numbers[prefix + key]
                    yield ComparedErrors(name, f"{kind}, {against}", (x, y, z))


def origin(run: RecordedRun) -> str:
    """Return the origin of a run's data as a short text for its figures, e.g. "simulated bench, seed 0"."""
    seed = run.summary.get("seed")
    if not run.simulated:
        return "bench"
    return "simulated bench" if seed is None or not _own_lab(run) else f"simulated bench, seed {seed}"


def _own_lab(run: RecordedRun) -> bool:
    """Return whether the devices were those of the built-in virtual lab, whose random numbers have a seed."""
    return any(case.truth_known for case in run.cases)


def head(run: RecordedRun) -> Iterator[str]:
    """Yield the title of a report, and notes about simulated parts, deviations from the case and incomplete cases."""
    title = run.table.get("title") or run.summary.get("title") or run.experiment
    yield from document.page_head(str(title), run.folder.name)
    if run.simulated:
        labs = {case.name: str(case.metadata.get("lab", {}).get("title", "")) for case in run.cases}
        first = next(iter(labs.values())) or str(run.summary.get("lab", "virtual lab"))
        others = "".join(f" Case '{name}': {title}." for name, title in labs.items() if title not in ("", first))
        yield document.paragraph(
            f"{origin(run)[0].upper()}{origin(run)[1:]}: {first}.{others}"
            " The paper's numbers come from a real bench (those of its Figs. 3 and 4 from a simulation).",
            "note",
        )
    for case in run.cases:
        for text in case.metadata.get("otherwise", ()):
            yield document.paragraph(f"Case '{case.name}' was {text}.", "note")
    if (rate := run.summary.get("clock_rate", 1.0)) != 1.0:
        yield document.paragraph(f"Not in real time: the station's clock ran at {rate:g} times real time.", "note")
    for name, numbers in run.summary.get("cases", {}).items():
        if not numbers.get("completed", True):
            yield document.paragraph(f"Case '{name}' did not complete: {numbers.get('cause')}", "note")
    for case in run.cases:
        if case.stride > 1:
            yield document.paragraph(f"Case '{case.name}' is long: figures show every {case.stride}th tick.", "note")


def paper_table(run: RecordedRun) -> Iterator[str]:
    """Yield a table that compares the measured numbers with those of the paper."""
    printed = list(paper_comparison(run))
    bent = any(row.case.endswith("_distorted") for row in printed)
    note = (
        "Millimetres. Measured: error of the tracker's tip, as in the paper. True: error of the simulated tip."
        " Ratio: measured number divided by the paper's number."
        + (" Distorted: the tracker's field is bent, so that its positions have an error." if bent else "")
    )
    cells = [
        (row.case, row.quantity, f"{row.paper:g}", f"{row.measured:.2f}",
         "" if row.true is None else f"{row.true:.2f}", f"{row.ratio:.2f}")
        for row in printed
    ]  # fmt: skip
    head = ("case", "quantity", "paper", "here, measured", "here, true", "ratio")
    yield from document.section("The paper's numbers and ours", note, head, cells)


def result(run: RecordedRun) -> Iterator[str]:
    """Yield the outcome of a run, a sentence for each case, and a table of all errors."""
    yield document.heading("Result")
    if label := run.summary.get("label"):
        cause = run.summary.get("cause")
        yield document.paragraph(f"Ended: {label}{f', {cause}' if cause else ''}.")
    for case in run.cases:
        for time, text in case.marks:
            yield document.paragraph(f"Marked at {time:.1f} s{case.title_suffix}: {text}.")
    for name, found in case_outcomes(run.summary).items():
        case = run.case(name)
        yield document.paragraph(
            f"The {found.against} tip{'' if case is None else case.title_suffix}"
            f" was at most {found.largest_distance:.2f} mm"
            f" from its desired position, {found.rms_distance:.2f} mm RMS"
            + ("." if found.force is None else f"; the force on it was at most {found.force:.2f} N."),
            "result",
        )
    errors = list(all_errors(run))
    if errors:
        yield document.paragraph(f"Millimetres. {evaluation_note(run.summary.get('cases', {}))}")
        cells = ((row.case, row.kind, *(f"{value:.3f}" for value in row.values)) for row in errors)
        yield document.table(("case", "error", *AXES), cells, texts=2)


def direction_table(run: RecordedRun) -> Iterator[str]:
    """Yield a table of direction errors and smallest margins; only for robots with more than three joints."""
    rows = [
        (
            name,
            f"{numbers['true_p95_distance_mm']:.3f}",
            f"{off['p95']:.2f}",
            f"{off['max']:.2f}",
            ", ".join(f"{edge.replace('_', ' ')} {least:.3g}" for edge, least in numbers.get("smallest", {}).items()),
        )
        for name, numbers in run.summary.get("cases", {}).items()
        if (off := numbers.get("true_direction_error_deg"))
    ]
    note = (
        "Errors of the true tip. Angles are against the desired direction, or against the direction at the start"
        " if the direction was not controlled."
    )
    head = ("case", "95 % of distances [mm]", "95 % of angles [deg]", "largest [deg]", "smallest")
    yield from document.section("Where the tip pointed", note, head, rows, texts=1)


def bound_table(run: RecordedRun) -> Iterator[str]:
    """Yield a table that compares the errors of a run with the best possible ones; only for too fast loads."""
    rows = [
        (name, change, *(f"{value:.2f}" for value in (reached, least, reached / least)))
        for name, numbers in run.summary.get("cases", {}).items()
        for change, part in numbers.get("by_change", {}).items()
        if (least := part.get("best_possible_mm"))
        for reached in [part["true_max_distance_mm"]]
    ]
    note = (
        "Largest distance of the true tip from its path, in millimetres, after each moment at which the load starts to"
        " change. Best possible: joints within the speeds and accelerations of these stages, on the true tubes, with"
        " the load's course known from that moment on."
    )
    head = ("case", "load changes at", "reached", "best possible", "ratio")
    yield from document.section("Comparison with the best possible", note, head, rows)


def line_table(run: RecordedRun) -> Iterator[str]:
    """Yield a table of the commands and polls that each axis received over its serial line."""
    rows = [
        (name, axis, f"{rates['velocities_per_s']:.1f}", f"{rates['polls_per_s']:.1f}")
        for name, numbers in run.summary.get("cases", {}).items()
        for axis, rates in numbers.get("line_rates", {}).items()
    ]
    head = ("case", "axis", "velocities per second", "position polls per second")
    yield from document.section("Serial line", "", head, rows)


def source(folder: Path) -> Iterator[str]:
    """Yield the text of the experiment's file."""
    if text := _source_text(folder):
        yield document.heading("Experiment")
        yield document.text_block(text)


def _source_text(folder: Path) -> str:
    path = folder / EXPERIMENT_FILE
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def configuration(run: RecordedRun) -> Iterator[str]:
    """Yield the sections with the experiment's file and all metadata of the recordings."""
    yield from source(run.folder)
    text = _source_text(run.folder)
    first: dict[str, str] = {}
    for case in run.cases:
        lines = dict(_lines("", {key: value for key, value in case.metadata.items() if value != text}))
        changed = {key: value for key, value in lines.items() if first.get(key) != value}
        if changed:
            more = ": differences from the first case" if first else ""
            yield document.heading(f"Configuration and versions{case.title_suffix}{more}")
            yield document.text_block("\n".join(f"{key} = {value}" for key, value in changed.items()))
        first = first or lines


def _lines(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield dotted key and text of each value in nested tables."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _lines(f"{name}.{key}" if name else str(key), inner)
    elif isinstance(value, list | tuple) and any(isinstance(inner, Mapping) for inner in value):
        for number, inner in enumerate(value):
            yield from _lines(f"{name}[{number}]", inner)
    elif name == "started" and isinstance(value, float | int):
        yield name, datetime.fromtimestamp(value).astimezone().isoformat(timespec="seconds")
    else:
        yield name, json.dumps(value, ensure_ascii=False)
