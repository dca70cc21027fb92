"""Texts and tables of a run's report: first line, table of results, serial line, configuration and versions.

The errors come from the run's summary, in millimetres, from the time `counted_from_s` on. `measured` errors compare the
desired tip with the tracker, as in the paper; `true` errors compare it with the simulated real robot (plant).
"""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from station.experiments.output import RESULT_HEAD, result_rows
from station.recording.headline import headline
from station.report import document
from station.report.run import RecordedRun, experiment_text


def origin(run: RecordedRun) -> str:
    """Return the origin of a run's data as a short text for its figures, e.g. "simulated bench, seed 0"."""
    seed = run.summary.get("seed")
    if not run.simulated:
        return "bench"
    # Only the built-in virtual lab, which knows the truth, has random numbers with a seed.
    own_lab = any(case.truth_known for case in run.cases)
    return f"simulated bench, seed {seed}" if own_lab and seed is not None else "simulated bench"


def head(run: RecordedRun) -> Iterator[str]:
    """Yield the title of a report, and notes about simulated parts, deviations from the case and incomplete cases."""
    title = run.table.get("title") or run.summary.get("title") or run.experiment
    yield from document.page_head(str(title), run.folder.name)
    if line := headline(run.summary):
        yield document.paragraph(str(line), "result")
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
        if case.missing:
            text = f"Case '{case.name}': {case.missing}, in the time of the recording. Figures have lines there."
            yield document.paragraph(text, "note")
        if case.stride > 1:
            yield document.paragraph(f"Case '{case.name}' is long: figures show every {case.stride}th tick.", "note")


def result(run: RecordedRun) -> Iterator[str]:
    """Yield the outcome of a run, a sentence for each case, and a table of all errors."""
    yield document.heading("Result")
    if label := run.summary.get("label"):
        cause = run.summary.get("cause")
        yield document.paragraph(f"Ended: {label}{f', {cause}' if cause else ''}.")
    for case in run.cases:
        for time, text in case.marks:
            yield document.paragraph(f"Marked at {time:.1f} s{case.title_suffix}: {text}.")
    cases = run.summary.get("cases", {})
    for name, numbers in cases.items() if len(cases) > 1 else ():
        if found := headline({**run.summary, "cases": {name: numbers}}):
            yield document.paragraph(f"{name.replace('_', ' ')}: {found}.", "result")
    paper = run.table.get("paper", {})
    if rows := list(result_rows(run.experiment, paper, cases)):
        note = "Measured: error of the tip by the tracker, as in the paper. True: error of the simulated tip."
        if any(name.endswith("_distorted") for name in cases):
            note += " Distorted: the tracker's field is distorted, so its positions have an error."
        yield document.paragraph(note)
        yield document.table(RESULT_HEAD, rows, texts=2)


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
    if text := experiment_text(folder):
        yield document.heading("Experiment")
        yield document.text_block(text)


def configuration(run: RecordedRun) -> Iterator[str]:
    """Yield the sections with the experiment's file and all metadata of the recordings."""
    yield from source(run.folder)
    text = experiment_text(run.folder)
    first: dict[str, str] = {}
    for case in run.cases:
        lines = dict(dotted("", {key: value for key, value in case.metadata.items() if value != text}))
        changed = {key: value for key, value in lines.items() if first.get(key) != value}
        if changed:
            more = ": differences from the first case" if first else ""
            yield document.heading(f"Configuration and versions{case.title_suffix}{more}")
            yield document.text_block("\n".join(f"{key} = {value}" for key, value in changed.items()))
        first = first or lines


def dotted(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield dotted key and text of each value in nested tables."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from dotted(f"{name}.{key}" if name else str(key), inner)
    elif isinstance(value, list | tuple) and any(isinstance(inner, Mapping) for inner in value):
        for number, inner in enumerate(value):
            yield from dotted(f"{name}[{number}]", inner)
    elif name == "started" and isinstance(value, float | int):
        yield name, datetime.fromtimestamp(value).astimezone().isoformat(timespec="seconds")
    else:
        yield name, json.dumps(value, ensure_ascii=False)
