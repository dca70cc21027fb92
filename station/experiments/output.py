"""Results of an experiment: recordings and summary on the disk, table on the screen."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table
from rich.text import Text

from core.robot.robot import Array
from station.config.regions import mesh_hashes
from station.control.clock import Clock, VirtualClock
from station.control.telemetry import Channels
from station.experiments.experiment import Case, Experiment
from station.experiments.results import summarise
from station.experiments.runner import INTERRUPTED, run_case
from station.recording.press_outcome import counted_text
from station.recording.read import MAX_SUMMARY_ROWS
from station.recording.recover import recover
from station.recording.run_folder import RunFolder
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import CaseRecorder, CaseWriter


class CaseAssignment(NamedTuple):
    """Case that is to be carried out and recorded, in this process or another one."""

    case: Case
    seed: int
    path: Path  #: file of the recording
    metadata: Mapping[str, Any]

    def writer(self) -> CaseWriter:
        """Create the recording's file and return its writer.

        Raises:
            RecordingError: the file cannot be created.
        """
        robot = self.case.robot.robot()
        return CaseWriter(self.path, robot, Channels(robot).all, self.metadata)


class RecordedResult(NamedTuple):
    """Result of a recorded case."""

    name: str
    numbers: Mapping[str, Any]  #: summary by `summarise`
    label: RunOutcome | None  #: outcome of the recording

    @property
    def completed(self) -> bool:
        """Whether the case ran to its end."""
        return bool(self.numbers["completed"])


class SummaryRows:
    """Rows of a run in full precision, from which its summary is computed; a recording rounds them.

    If a run has more than `most` rows, only every n-th row is kept; n is a power of two.
    """

    def __init__(self, most: int) -> None:
        self.rows: list[Array] = []
        self._most, self._stride, self._count = most, 1, 0

    def add(self, row: Array) -> None:
        """Add a row (channels,), which must not change later."""
        if self._count % self._stride == 0:
            self.rows.append(row)
            if len(self.rows) > self._most:
                self.rows, self._stride = self.rows[::2], 2 * self._stride
        self._count += 1


def run_recorded(
    assignment: CaseAssignment, progress: Callable[[float], None], clock: Callable[[], Clock] = VirtualClock
) -> RecordedResult:
    """Carry out a case with a new `clock`, record it and return its summary.

    Raises:
        RecordingError: the file cannot be created or finished.
    """
    writer = assignment.writer()
    recorder, kept = CaseRecorder(writer, len(writer.channels)), SummaryRows(MAX_SUMMARY_ROWS)

    def record(row: Array) -> None:
        recorder.write(row)
        kept.add(row)

    try:
        run = run_case(assignment.case, assignment.seed, clock(), progress, record)
    except BaseException:
        with contextlib.suppress(RecordingError):  # a later recovery finishes this file
            recorder.close(RunOutcome.INTERRUPTED, "the run was aborted")
        raise
    recorder.close(label_of(completed=run.completed, cause=run.cause), run.cause)
    if assignment.path.exists():  # the file is missing if the disk was full
        run = run._replace(rows=np.array(kept.rows).reshape(-1, len(writer.channels)))
    return RecordedResult(assignment.case.name, summarise(run), writer.label)


class ResultFolder:
    """Folder for the results of one run of an experiment; it gets its final name when the run is complete."""

    def __init__(self, out: Path, experiment: Experiment, seed: int) -> None:
        """Create the folder under a provisional name and recover the folders of killed runs.

        Raises:
            RecordingError: `out` cannot be written to.
        """
        self._out, self._experiment, self._seed = out, experiment, seed
        self._folder = RunFolder(out, f"{experiment.name}-seed{seed}-{datetime.now().astimezone():%Y%m%d-%H%M%S}")
        self._folder.add_source(experiment.source)
        self.recovered = recover(out).folders  #: folders of killed runs that were recovered now

    @property
    def path(self) -> Path:
        """Final path of the results folder."""
        return self._folder.path

    def assignment(self, case: Case) -> CaseAssignment:
        """Return everything that a worker process needs to carry out a case and record it in this folder."""
        metadata = case_metadata(self._experiment, case, self._seed)
        return CaseAssignment(case, self._seed, self._folder.case(case.name), metadata)

    def finish(self, summary: Mapping[str, Any], labels: Iterable[RunOutcome | None] = ()) -> None:
        """Write the summary and give the results folder its final name; `labels` are the outcomes of the recordings.

        Raises:
            RecordingError: the disk is full; the next command that recovers runs finishes this folder.
        """
        cases = summary.get("cases", {}).values()
        cause = next((case["cause"] for case in cases if case.get("cause")), "")
        label = label_of(completed=bool(summary.get("completed")), cause=cause)
        if RunOutcome.INCOMPLETE in labels:
            label = RunOutcome.INCOMPLETE
        ended = {"label": label, "cause": cause}
        self._folder.finish({"title": self._experiment.title, "started": self._folder.started, **summary, **ended})

    def abandon(self) -> None:
        """Keep the recorded rows as an interrupted run after an error; remove the folder if no row was recorded."""
        self._folder.let_go()
        recover(self._out)


def case_metadata(experiment: Experiment, case: Case, seed: int) -> dict[str, Any]:
    """Return everything that the result of a case depends on; it becomes the metadata of the recording."""
    meshes = mesh_hashes(case.file.keep_out)
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "case": case.name,
        "seed": seed,
        **({"meshes": meshes} if meshes else {}),
        "settings": case.file.model_dump(mode="json"),
        "robot": case.robot.model_dump(mode="json"),
        "lab": case.lab.model_dump(mode="json"),
        "source": experiment.source,
    }


def label_of(*, completed: bool, cause: str) -> RunOutcome:
    """Return the outcome of a run from the result of its runner."""
    if completed:
        return RunOutcome.COMPLETE
    return RunOutcome.INTERRUPTED if cause == INTERRUPTED else RunOutcome.STOPPED


#: Heads of the table of results; the numbers start after the first two.
RESULT_HEAD = ("case", "quantity", "x", "y", "z", "paper")


def result_table(experiment: Experiment, summary: Mapping[str, Any]) -> Table:
    """Return a table that compares the numbers of a run with those of the paper, for the terminal."""
    title = Text(f"{experiment.title}\n{experiment.cases[0].lab.title}")
    table = Table(title=title, title_style="")
    for column, head in enumerate(RESULT_HEAD):
        table.add_column(head, justify="left" if column < 2 else "right")
    paper = {name: numbers.model_dump() for name, numbers in experiment.paper.items()}
    for name, case in summary["cases"].items():
        label = name if case["completed"] else f"{name} (not completed)"
        for _, *cells in result_rows(experiment.name, paper, {name: case}):
            table.add_row(label, *cells)
            label = ""
        table.add_section()
    return table


def result_rows(
    experiment: str, paper: Mapping[str, Any], cases: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of results, which are the same in terminal and report.

    `paper` has the paper's numbers by case; a case `NAME_distorted` has those of the case `NAME`.
    """
    for name, case in cases.items():
        for row in _rows(experiment, paper.get(name.removesuffix("_distorted"), {}), case):
            yield name, *row


def _rows(
    experiment: str, paper: Mapping[str, Mapping[str, float]], case: Mapping[str, Any]
) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield a table row for each quantity of the case: its name, x, y, z and the paper's number."""
    reported = "\n".join(f"{axis} {value:g}" for axis, value in paper.get("max_abs_error_mm", {}).items())
    since = f"from {case.get('counted_from_s', 0.0):g} s on"
    for key, title, published in (
        ("max_abs_error_mm", "max |E| measured", reported),
        ("true_max_abs_error_mm", "max |E| true", ""),
        ("rms_error_mm", "RMS E measured", ""),
        ("true_rms_error_mm", "RMS E true", ""),
    ):
        if key in case:
            x, y, z = (f"{value:.3f}" for value in case[key])
            yield f"{title}, {since} [mm]", x, y, z, published
    for key, start in (("true_max_distance_mm", "counted_from_s"), ("settled_true_max_distance_mm", "settled_from_s")):
        if "settled_from_s" in case:
            yield f"max distance true from {case[start]:g} s on [mm]", "", "", f"{case[key]:.3f}", ""
    if "true_p95_distance_mm" in case:
        yield "distance true, 95 % [mm]", "", "", f"{case['true_p95_distance_mm']:.3f}", ""
    if off := case.get("true_direction_error_deg"):
        yield "direction true, 95 %, largest [deg]", "", f"{off['p95']:.2f}", f"{off['max']:.2f}", ""
    if "force_by_deflection_rms_error_N" in case and "force_rms_error_N" not in case:
        hits, unknown = (100.0 * case[f"force_by_deflection_{name}"] for name in ("in_95", "unknown"))
        title = (
            f"RMS error of the force from the deflection [N] ({hits:.0f} % in the 95 % interval; {unknown:.0f} % of the"
        )
        title += " directions unknown and left out)"
        yield title, "", "", f"{case['force_by_deflection_rms_error_N']:.4f}", ""
    if press := case.get("press"):
        for name, prefix in (("estimated", ""), ("true", "true_")):
            if f"{prefix}mean_error_N" in press:
                numbers = f"{press[f'{prefix}mean_error_N']:.4f}", f"{press[f'{prefix}rms_error_N']:.4f}"
                yield f"error of the force held, {name}, {counted_text(press)}: mean, RMS [N]", "", *numbers, ""
    if "rms_relative_error" in (palpation := case.get("palpation", {})):
        errors = f"{100.0 * palpation['rms_relative_error']:.1f}", f"{100.0 * palpation['max_relative_error']:.1f}"
        yield "error of the stiffness of the known places: RMS, largest [%]", "", *errors, ""
    for edge, margin in case.get("smallest", {}).items():
        yield f"smallest {edge.replace('_', ' ')}", "", "", f"{margin:.3f}", ""
    if "best_possible_mm" in case:
        for name, part in case["by_change"].items():
            title = f"max distance true from {name} on [mm] (best possible: {part['best_possible_mm']:.3f})"
            yield title, "", "", f"{part['true_max_distance_mm']:.3f}", ""
    if step := case.get("step"):
        fitted = f"{step['rate']:.3f} 1/s, {1e3 * step['dead_time_s']:.0f} ms"
        yield f"fitted rate (eq. 31: {step['expected_rate']:g} 1/s), dead time", "", "", fitted, ""
    if "max_abs_error_mm" not in case:
        for model, value in case.get("model_error_mm", {}).items():
            published = f"{paper['model_error_mm'][model]:g}" if model in paper.get("model_error_mm", {}) else ""
            yield f"mean |tip - {model} model| [mm]", "", "", f"{value:.3f}", published
    if experiment == "fig4" and "deflection_max_mm" in case:
        for key, title in (("deflection", "Delta_total"), ("delta_1", "Delta_1"), ("delta_2", "Delta_2")):
            x, y, z = (f"{value:.3f}" for value in case["deflection_max_mm"][key])
            yield f"max |{title}| [mm]", x, y, z, ""
    if not case.get("completed", True):
        yield case["cause"], "", "", "", ""
