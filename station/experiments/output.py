"""Results on disk and on the screen."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from station.control.clock import Clock, VirtualClock
from station.control.telemetry import Channels
from station.experiments.experiment import Case, Experiment, PaperNumbers
from station.experiments.results import summarise
from station.experiments.runner import INTERRUPTED, run_case
from station.recording.case_recorder import CaseRecorder
from station.recording.label import Label, RecordingError
from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_folder import RunFolder
from station.recording.tracking_errors import which_count
from station.recording.writer import CaseWriter

#: Rows that a summary is made of: all of a run of up to half an hour, every n-th of a longer one.
MOST = 1_000_000


class Assignment(NamedTuple):
    """A case to carry out and to record, here or in another process."""

    case: Case
    seed: int
    path: Path  #: of its recording
    metadata: Mapping[str, Any]

    def writer(self) -> CaseWriter:
        """Makes the file.

        Raises:
            RecordingError: it cannot be made.
        """
        robot = self.case.robot.robot()
        return CaseWriter(self.path, robot, Channels(robot).all, self.metadata)


class Recorded(NamedTuple):
    """What came of it."""

    name: str
    numbers: Mapping[str, Any]  #: those of `summarise`
    label: Label | None  #: of the recording

    @property
    def completed(self) -> bool:
        """Whether the case came to its end."""
        return bool(self.numbers["completed"])


def run_recorded(assignment: Assignment, progress: Callable[[float], None], clock: Clock | None = None) -> Recorded:
    """Carry out a case, record it and sum it up; in virtual time unless told otherwise.

    Raises:
        RecordingError: the file cannot be made, finished or read back.
    """
    writer = assignment.writer()
    recorder = CaseRecorder(writer, len(writer.channels))
    try:
        run = run_case(assignment.case, assignment.seed, clock or VirtualClock(), progress, recorder.write)
    except BaseException:
        with contextlib.suppress(RecordingError):  # the recovery tries once more
            recorder.close(Label.INTERRUPTED, "the run was given up")
        raise
    recorder.close(label_of(completed=run.completed, cause=run.cause), run.cause)
    if assignment.path.exists():  # not, when the disk has ended it
        run = run._replace(rows=read_case(assignment.path, MOST).rows)
    return Recorded(assignment.case.name, summarise(run), writer.label)


class ResultFolder:
    """A folder of its own for each run of an experiment; it gets its name only when everything is in it."""

    def __init__(self, out: Path, experiment: Experiment, seed: int) -> None:
        """Make the folder under a provisional name, before anything runs; earlier ones left behind are recovered.

        Raises:
            RecordingError: `out` cannot be written to.
        """
        self._out, self._experiment, self._seed = out, experiment, seed
        self._folder = RunFolder(out, f"{experiment.name}-seed{seed}-{datetime.now().astimezone():%Y%m%d-%H%M%S}")
        self._folder.add_source(experiment.source)
        self.recovered = recover(out)  #: folders of earlier runs that were killed

    @property
    def path(self) -> Path:
        """Where the folder will be."""
        return self._folder.path

    def assignment(self, case: Case) -> Assignment:
        """What a process has to know to carry out a case and to record it here."""
        metadata = case_metadata(self._experiment, case, self._seed)
        return Assignment(case, self._seed, self._folder.case(case.name), metadata)

    def finish(self, summary: Mapping[str, Any], labels: Iterable[Label | None] = ()) -> None:
        """Add the summary; then the folder gets its name. `labels` are those of its recordings.

        Raises:
            RecordingError: the disk takes no more; what is there is kept for the next recovery.
        """
        cases = summary.get("cases", {}).values()
        cause = next((case["cause"] for case in cases if case.get("cause")), "")
        label = label_of(completed=bool(summary.get("completed")), cause=cause)
        if Label.INCOMPLETE in labels:
            label = Label.INCOMPLETE
        ended = {"label": label, "cause": cause}
        self._folder.finish({"title": self._experiment.title, "started": self._folder.started, **summary, **ended})

    def abandon(self) -> None:
        """Something went wrong: keep what was recorded, as a run that was interrupted; nothing if there is nothing."""
        self._folder.let_go()
        with contextlib.suppress(RecordingError):  # what went wrong first is to be told; this waits for the next start
            recover(self._out)


def case_metadata(experiment: Experiment, case: Case, seed: int) -> dict[str, Any]:
    """Everything that a case depends on, for its recording."""
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "case": case.name,
        "seed": seed,
        "settings": case.file.model_dump(mode="json"),
        "robot": case.robot.model_dump(mode="json"),
        "lab": case.lab.model_dump(mode="json"),
        "source": experiment.source,
    }


def label_of(*, completed: bool, cause: str) -> Label:
    """How a run ended, from what its runner says."""
    if completed:
        return Label.COMPLETE
    return Label.INTERRUPTED if cause == INTERRUPTED else Label.STOPPED


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
    table.caption = which_count(summary["cases"])
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
    for key, begin in (("true_max_distance_mm", "counted_from_s"), ("settled_true_max_distance_mm", "settled_from_s")):
        if "settled_from_s" in case:
            yield f"max distance true from {case[begin]:g} s on [mm]", "", "", f"{case[key]:.3f}", ""
    if off := case.get("true_direction_error_deg"):
        yield "distance true, 95 % [mm]", "", "", f"{case['true_p95_distance_mm']:.3f}", ""
        yield "direction true, 95 %, largest [deg]", "", f"{off['p95']:.2f}", f"{off['max']:.2f}", ""
    for edge, room in case.get("smallest", {}).items():
        yield f"smallest {edge.replace('_', ' ')}", "", "", f"{room:.3f}", ""
    if "best_possible_mm" in case:
        for name, part in case["by_change"].items():
            words = f"max distance true from {name} on [mm] (best possible: {part['best_possible_mm']:.3f})"
            yield words, "", "", f"{part['true_max_distance_mm']:.3f}", ""
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
