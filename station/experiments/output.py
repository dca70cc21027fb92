"""Results on disk and on the screen."""

import itertools
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from core.errors import CtrError
from station.experiments.experiment import Experiment, PaperNumbers
from station.experiments.runner import Recording


class OutputError(CtrError):
    """Results that cannot be written."""


class ResultFolder:
    """A folder of its own for each run; it gets its name only when everything is in it."""

    def __init__(self, out: Path, experiment: str, seed: int) -> None:
        """Make the folder under a provisional name, before anything runs.

        Raises:
            OutputError: `out` cannot be written to.
        """
        self._out = out
        name = f"{experiment}-seed{seed}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
        with self._written():
            out.mkdir(parents=True, exist_ok=True)
            for number in itertools.count(1):
                self.path = out / (name if number == 1 else f"{name}-{number}")
                self._partial = self.path.with_name(self.path.name + ".partial")
                try:
                    self._partial.mkdir()
                except FileExistsError:
                    continue
                if not self.path.exists():
                    break
                self._partial.rmdir()

    def write_case(self, recording: Recording) -> None:
        """All channels of a case as CSV, units in the column names."""
        path = self._partial / f"{recording.case.name}.csv"
        with self._written(), path.open("w", encoding="ascii") as file:
            file.write(",".join(channel.column for channel in recording.channels.all) + "\n")
            line = ",".join(["%.9g"] * len(recording.channels)) + "\n"
            file.writelines(line % tuple(row) for row in recording.rows.tolist())

    def finish(self, experiment: Experiment, summary: Mapping[str, Any]) -> None:
        """The experiment's file and the summary; then the folder gets its name."""
        with self._written():
            (self._partial / "experiment.toml").write_text(experiment.source, encoding="utf-8")
            (self._partial / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
            self._partial.rename(self.path)

    def discard(self) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self._partial, ignore_errors=True)

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(f"{self._out}: cannot write results there: {error.strerror}") from None


def result_table(experiment: Experiment, summary: Mapping[str, Any]) -> Table:
    """The paper's numbers beside ours."""
    title = Text(f"{experiment.title}\n{experiment.cases[0].lab.title}")
    table = Table(title=title, title_style="", caption_style="")
    table.add_column("case")
    table.add_column("quantity")
    for axis in ("x", "y", "z"):
        table.add_column(axis, justify="right")
    table.add_column("paper", justify="right")
    for name, case in summary["cases"].items():
        label = name if case["completed"] else f"{name} (not completed)"
        for row in _rows(experiment, name, case):
            table.add_row(label, *row)
            label = ""
        table.add_section()
    return table


def _rows(experiment: Experiment, name: str, case: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str, str]]:
    """Quantity, x, y, z and the paper's number, for what the case has."""
    paper = experiment.paper.get(name, PaperNumbers())
    reported = "\n".join(f"{axis} {value:g}" for axis, value in paper.max_abs_error_mm.items())
    for key, title, beside in (
        ("max_abs_error_mm", "max |E| measured [mm]", reported),
        ("true_max_abs_error_mm", "max |E| true [mm]", ""),
        ("true_rms_error_mm", "RMS E true [mm]", ""),
    ):
        if key in case:
            x, y, z = (f"{value:.3f}" for value in case[key])
            yield title, x, y, z, beside
    if step := case.get("step"):
        fitted = f"{step['rate']:.3f} 1/s, {1e3 * step['dead_time_s']:.0f} ms"
        yield f"fitted rate (eq. 31: {step['expected_rate']:g} 1/s), dead time", "", "", fitted, ""
    if "max_abs_error_mm" not in case:
        for model, value in case.get("model_error_mm", {}).items():
            beside = f"{paper.model_error_mm[model]:g}" if model in paper.model_error_mm else ""
            yield f"mean |tip - {model} model| [mm]", "", "", f"{value:.3f}", beside
    if experiment.name == "fig4" and "deflection_max_mm" in case:
        for key, title in (("deflection", "Delta_total"), ("delta_1", "Delta_1"), ("delta_2", "Delta_2")):
            x, y, z = (f"{value:.3f}" for value in case["deflection_max_mm"][key])
            yield f"max |{title}| [mm]", x, y, z, ""
    if not case["completed"]:
        yield case["cause"], "", "", "", ""
