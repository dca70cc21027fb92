"""What a report says besides figures: how it ended, what was simulated, the line, configuration and versions."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

from station.recording.outcome import outcomes
from station.recording.tracking_errors import which_count
from station.report import document
from station.report.comparison import all_errors, beside_the_paper
from station.report.run import Run
from station.report.style import AXES


def origin(run: Run) -> str:
    """Where the data come from, short enough for a figure."""
    seed = run.summary.get("seed")
    return f"simulated bench, seed {seed}" if run.simulated else "bench"


def head(run: Run) -> Iterator[str]:
    """Title, and in plain words what was simulated."""
    title = run.table.get("title") or run.summary.get("title") or run.experiment
    yield f"<h1>{escape(str(title))}</h1>"
    yield document.paragraph(run.folder.name, "sub")
    if run.simulated:
        labs = {case.name: str(case.metadata.get("lab", {}).get("title", "")) for case in run.cases}
        first = next(iter(labs.values())) or str(run.summary.get("lab", "virtual lab"))
        others = "".join(f" Case '{name}': {title}." for name, title in labs.items() if title not in ("", first))
        yield document.paragraph(
            f"Simulated bench, seed {run.summary.get('seed')}: {first}.{others}"
            " The paper's numbers come from a real bench (those of its Figs. 3 and 4 from a simulation of its own).",
            "note",
        )
    for case in run.cases:
        for text in case.metadata.get("otherwise", ()):
            yield document.paragraph(f"Case '{case.name}' was {text}.", "note")
    if (rate := run.summary.get("clock_rate", 1.0)) != 1.0:
        yield document.paragraph(f"Not in real time: the station's clock went at {rate:g} of it.", "note")
    for name, numbers in run.summary.get("cases", {}).items():
        if not numbers.get("completed", True):
            yield document.paragraph(f"Case '{name}' did not complete: {numbers.get('cause')}", "note")
    for case in run.cases:
        if case.stride > 1:
            yield document.paragraph(f"Case '{case.name}' is long: figures show every {case.stride}th tick.", "note")


def beside_table(run: Run) -> Iterator[str]:
    """The paper's numbers beside ours."""
    printed = list(beside_the_paper(run))
    bent = any(row.case.endswith("_distorted") for row in printed)
    if printed:
        yield document.heading("The paper's numbers and ours")
        yield document.paragraph(
            "Millimetres. Measured: against the tracker, as in the paper. True: against the simulated tip."
            " Ratio: measured here to the paper's number."
            + (" Distorted: the tracker's field is bent, so that it shows the tip where it is not." if bent else "")
        )
        head = ("case", "quantity", "paper", "here, measured", "here, true", "ratio")
        cells = (
            (row.case, row.quantity, f"{row.paper:g}", f"{row.measured:.2f}",
             "" if row.true is None else f"{row.true:.2f}", f"{row.ratio:.2f}")
            for row in printed
        )  # fmt: skip
        yield document.table(head, cells, texts=2)


def result(run: Run) -> Iterator[str]:
    """How it ended and how well it went: a sentence for each case, then all errors."""
    yield document.heading("Result")
    if label := run.summary.get("label"):
        cause = run.summary.get("cause")
        yield document.paragraph(f"Ended: {label}{f', {cause}' if cause else ''}.")
    for name, found in outcomes(run.summary).items():
        case = run.case(name)
        yield document.paragraph(
            f"The {found.against} tip{'' if case is None else case.words} was at most {found.largest_distance:.2f} mm"
            f" from where it should have been, {found.rms_distance:.2f} mm RMS"
            + ("." if found.force is None else f"; the force on it was at most {found.force:.2f} N."),
            "result",
        )
    errors = list(all_errors(run))
    if errors:
        yield document.paragraph(f"Millimetres. {which_count(run.summary.get('cases', {}))}")
        cells = ((row.case, row.kind, *(f"{value:.3f}" for value in row.values)) for row in errors)
        yield document.table(("case", "error", *AXES), cells, texts=2)


def direction_table(run: Run) -> Iterator[str]:
    """Of more joints than a place takes: where the tip pointed, and how near the joints came to edges."""
    rows = [
        (
            name,
            f"{numbers['true_p95_distance_mm']:.3f}",
            f"{off['p95']:.2f}",
            f"{off['max']:.2f}",
            ", ".join(f"{edge.replace('_', ' ')} {room:.3g}" for edge, room in numbers.get("smallest", {}).items()),
        )
        for name, numbers in run.summary.get("cases", {}).items()
        if (off := numbers.get("true_direction_error_deg"))
    ]
    if rows:
        yield document.heading("Where the tip pointed")
        yield document.paragraph(
            "Against the true tip: from where it should have pointed, or from where it did at the start where nothing"
            " was asked of the direction."
        )
        head = ("case", "95 % of distances [mm]", "95 % of angles [deg]", "largest [deg]", "smallest")
        yield document.table(head, rows, texts=1)


def bound_table(run: Run) -> Iterator[str]:
    """Where loads are faster than the joints: what was reached, and the best that was possible."""
    rows = [
        (
            name,
            begin,
            f"{part['true_max_distance_mm']:.2f}",
            f"{least:.2f}",
            f"{part['true_max_distance_mm'] / least:.2f}",
        )
        for name, numbers in run.summary.get("cases", {}).items()
        for begin, part in numbers.get("by_change", {}).items()
        if (least := part.get("best_possible_mm"))
    ]
    if rows:
        yield document.heading("Distance from the possible")
        yield document.paragraph(
            "Largest distance of the true tip from its path, in millimetres, from each moment on at which the load"
            " begins to change. Best possible: joints at the speeds and accelerations of these stages, on the true"
            " tubes, that know the load's course from that moment on."
        )
        yield document.table(("case", "load changes at", "reached", "best possible", "ratio"), rows, texts=2)


def line_table(run: Run) -> Iterator[str]:
    """What each axis really got over its line, where stages were driven over one."""
    rows = [
        (name, axis, f"{rates['velocities_per_s']:.1f}", f"{rates['polls_per_s']:.1f}")
        for name, numbers in run.summary.get("cases", {}).items()
        for axis, rates in numbers.get("line_rates", {}).items()
    ]
    if rows:
        yield document.heading("Serial line")
        yield document.table(("case", "axis", "velocities per second", "position polls per second"), rows, texts=2)


def source(folder: Path) -> Iterator[str]:
    """The experiment's file."""
    if text := _source_text(folder):
        yield document.heading("Experiment")
        yield document.text_block(text)


def _source_text(folder: Path) -> str:
    path = folder / "experiment.toml"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def configuration(run: Run) -> Iterator[str]:
    """The experiment's file, and everything that the recordings know about how they were made."""
    yield from source(run.folder)
    text = _source_text(run.folder)
    first: dict[str, str] = {}
    for case in run.cases:
        lines = dict(_lines("", {key: value for key, value in case.metadata.items() if value != text}))
        changed = {key: value for key, value in lines.items() if first.get(key) != value}
        if changed:
            more = ", what differs from the first case" if first else ""
            yield document.heading(f"Configuration and versions{case.words}{more}")
            yield document.text_block("\n".join(f"{key} = {value}" for key, value in changed.items()))
        first = first or lines


def _lines(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Nested tables as dotted keys."""
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
