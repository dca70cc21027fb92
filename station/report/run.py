"""Read a run's folder for a report: summary, experiment's file, and telemetry rows of every case."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.strict import ConfigError, merged, parse_toml, text_of
from station.control.task import Phase
from station.control.telemetry import Channel
from station.devices.interfaces import ABSENT
from station.experiments.experiment import variants
from station.recording.foxglove import MARK
from station.recording.read import missing_rows, read_case
from station.recording.run_folder import EXPERIMENT_FILE, LIVE_CASE, SUMMARY_FILE, recordings
from station.recording.run_outcome import desired, frame_errors, motion_errors, unknown_axes
from station.regular_file import is_regular, read_in

#: Channel groups of a recording that reports and players need; other groups are not kept in memory.
KEPT_GROUPS = frozenset((
    "time", "phase", "joints", "force", "force_filtered", "force_variance", "force_true", "tip_new", "tip_time",
    "tip_measured", "tip_estimated", "tip_unloaded", "tip_desired", "tip_observed", "truth_known", "tip_true",
    "deflection", "deflection_rate_raw", "deflection_rate", "deflection_rate_exact", "delta_1", "delta_2",
    "target_followed", "target_measured", "target_offset", "target_true", "trouble", "clearance",
))  # fmt: skip
#: Largest number of rows of a case in memory; a recording of more than 33 minutes is reduced to every n-th row.
MAX_ROWS = 1_000_000


class NoRun(CtrError):
    """A folder has no run, or none from which a report can be created."""


class ReportError(CtrError):
    """A report cannot be written."""


@dataclass(frozen=True)
class RecordedCase:
    """One recorded case of a run, with its rows, settings and results."""

    name: str
    channels: Sequence[Channel]
    rows: Array  #: (ticks, channels)
    file: Mapping[str, Any]  #: the experiment's table with this case's changes
    numbers: Mapping[str, Any]  #: part of the summary about this case
    metadata: Mapping[str, Any]
    stride: int = 1  #: n if `rows` has only every n-th tick
    marks: tuple[tuple[float, str], ...] = ()  #: time since the motion's start [s] and text of the operator's marks
    start: int = 0  #: wall time of the motion's start [ns since 1970]
    missing: str = ""  #: number and times of damaged rows in the time of the recording; empty if there are none

    def of(self, group: str) -> Array:
        """Return the columns of a channel group (ticks, columns), such as three for `tip_measured`.

        Raises:
            NoRun: the recording has no channels of this group.
        """
        at = [number for number, channel in enumerate(self.channels) if channel.name.rsplit(".", 1)[0] == group]
        if not at:
            raise NoRun(f"case '{self.name}' has no channels '{group}'; was it recorded by another version?")
        return self.rows[:, at[0] : at[-1] + 1]

    def names(self, group: str) -> list[str]:
        """Return the names of a channel group's columns, without the name of the group."""
        parts = (channel.name.rsplit(".", 1) for channel in self.channels)
        return [part[1] for part in parts if len(part) == 2 and part[0] == group]

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the case: those in the recording, or in its absence those of the experiment's file."""
        return self.metadata.get("settings") or self.file

    @property
    def title_suffix(self) -> str:
        """Name of the case for a title; empty for a free motion, which has only one case."""
        named = str(self.metadata.get("case", "" if self.name == LIVE_CASE else self.name))
        return f" (case {named.replace('_', ' ')})" if named else ""

    @property
    def time(self) -> Array:
        """Time since the motion's start (ticks,) [s]."""
        return self.of("time")[:, 0]

    @property
    def counted_from(self) -> float:
        """Time from which errors count [s]; without a summary the settling time, even if the load starts earlier."""
        return float(self.numbers.get("counted_from_s", self.file.get("settling", 0.0)))

    @property
    def truth_known(self) -> bool:
        """Whether the recording has the true tip of a virtual lab."""
        return bool(self.of("truth_known").all())

    @property
    def senses(self) -> bool:
        """Whether the rig had force sensors; without them the force is estimated from the deflection."""
        return bool((self.of("trouble")[:, 2] != ABSENT).any())

    @property
    def sweeps(self) -> bool:
        """Whether the motion was a sweep of a joint, which has no desired path of the tip."""
        return self.file.get("trajectory", {}).get("kind") == "joint_sweep"

    @property
    def moved(self) -> bool:
        """Whether the motion of the run started."""
        return bool((self.of("phase") == Phase.MOVING).any())

    @property
    def follows(self) -> bool:
        """Whether the tip followed a target."""
        return self.file.get("trajectory", {}).get("kind") == "follow"

    @property
    def errors(self) -> Mapping[str, Any]:
        """Errors and largest force of the summary; computed from the rows if the run ended without a summary."""
        return self.numbers if "counted_from_s" in self.numbers else motion_errors(self.of, 0.0, self.counted_from)

    @property
    def force_unknown(self) -> str:
        """Axes in which the estimated force is unknown: "", "z", "xz" ..."""
        return unknown_axes(self.of)

    @property
    def settled_from(self) -> float:
        """End of the settling time [s]."""
        return float(self.file.get("settling", 0.0))

    def desired_tip(self) -> Array:
        """Return the desired tip position (ticks, 3) [m]: the setpoint, or the true target plus its offset."""
        return desired(self.of, "target_true")

    def true_error(self) -> Array:
        """Return the desired tip position minus that of the simulated real robot (ticks, 3) [mm]."""
        return 1e3 * (self.desired_tip() - self.of("tip_true"))

    def distance(self) -> tuple[Array, Array]:
        """Return times (m,) [s] and distances (m,) from the desired tip [mm]: the true tip, else the measured one."""
        times, error = (self.time, self.true_error()) if self.truth_known else self.measured_error()
        return times, np.linalg.norm(error, axis=1)

    def measured_tip(self) -> tuple[Array, Array]:
        """Return measurement times (f,) [s] and measured tip positions (f, 3) [mm] of all tracker frames."""
        new = self.of("tip_new")[:, 0] > 0.0
        return self.of("tip_time")[new, 0], 1e3 * self.of("tip_measured")[new]

    def measured_error(self) -> tuple[Array, Array]:
        """Return measurement times (f,) [s] and desired minus measured tip (f, 3) [mm] of all tracker frames."""
        new = self.of("tip_new")[:, 0] > 0.0
        return self.of("tip_time")[new, 0], 1e3 * frame_errors(self.of, new, 0.0)


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run with everything that its folder contains."""

    folder: Path
    experiment: str
    summary: Mapping[str, Any]
    table: Mapping[str, Any]  #: content of the experiment's file
    cases: tuple[RecordedCase, ...]  #: cases whose recordings have rows

    @property
    def simulated(self) -> bool:
        """Whether the devices were simulated: the recording has the true tip, or the devices reported it."""
        return any(case.truth_known or case.metadata.get("simulated", False) for case in self.cases)

    def case(self, name: str) -> RecordedCase | None:
        """Return the case with this name, or None if its recording is missing or has no rows."""
        return next((case for case in self.cases if case.name == name), None)

    def paper(self, case: str, quantity: str) -> Mapping[str, float]:
        """Return the paper's numbers for a case; a case `NAME_distorted` has the numbers of the case `NAME`."""
        return self.table.get("paper", {}).get(case.removesuffix("_distorted"), {}).get(quantity, {})


def read_run(folder: Path) -> RecordedRun:
    """Return everything that a report needs of a run.

    Raises:
        NoRun: the folder has neither a recording nor a summary, or the summary is not JSON.
        ConfigError: the experiment's file cannot be read.
        RecordingError: a recording cannot be read.
    """
    found, summary_file = recordings(folder), folder / SUMMARY_FILE
    if not found and not is_regular(summary_file):
        raise NoRun(f"{folder}: no run in this folder: it has neither a recording (.mcap) nor summary.json")
    summary = read_json(summary_file) if os.path.lexists(summary_file) else {}
    table = parse_toml(experiment_text(folder), str(folder / EXPERIMENT_FILE))
    cases = [case for path in found if len((case := _read_case(path, table, summary)).rows)]
    order = list(summary.get("cases", {}))
    cases.sort(key=lambda case: order.index(case.name) if case.name in order else len(order))
    return RecordedRun(folder, str(summary.get("experiment", folder.name)), summary, table, tuple(cases))


def _read_case(path: Path, table: Mapping[str, Any], summary: Mapping[str, Any]) -> RecordedCase:
    """Return a case with the channels that reports show; a very long recording is reduced to every n-th row."""
    name, found = path.stem, read_case(path, MAX_ROWS, KEPT_GROUPS)
    file = merged(table, variants(table).get(name, {}))
    numbers = summary.get("cases", {}).get(name, {})
    rows, start = _motion_only(found.rows, found.channels, float(numbers.get("motion_start", 0.0)))
    marks = tuple((event.time - start, event.text) for event in found.events if event.kind == MARK)
    # A live run may have no experiment file; then its settings are in the metadata of the recording.
    file = file or {"settling": numbers.get("settling", 0.0), **found.metadata.get("settings", {})}
    return RecordedCase(
        name,
        found.channels,
        rows,
        file,
        numbers,
        found.metadata,
        found.stride,
        marks,
        found.epoch + round(1e9 * start),
        missing_rows(found.gaps),
    )


def _motion_only(rows: Array, channels: Sequence[Channel], start: float) -> tuple[Array, float]:
    """Return the rows of a live run's motion, with times from its start, and this start [s].

    The result has all rows if the motion never started.

    Args:
        rows: (ticks, channels).
        channels: channels of the rows.
        start: start of the motion according to the summary [s]; the summary of a recovered run does not have it.
    """
    names = [channel.name for channel in channels]
    times = rows[:, names.index("time")]
    if "phase" in names and (moving := rows[:, names.index("phase")] == Phase.MOVING).any():
        start = float(times[moving][0])
    elif start != 0.0:
        moving = times >= start
    else:
        return rows, 0.0
    kept = rows[moving]
    if start != 0.0:
        for name in ("time", "tip_time"):
            kept[:, names.index(name)] -= start
    return kept, start


def experiment_text(folder: Path) -> str:
    """Return the text of a run's experiment; empty if the run has none.

    Raises:
        ConfigError: the file cannot be read.
    """
    path = folder / EXPERIMENT_FILE
    try:
        return text_of(read_in(folder, EXPERIMENT_FILE))
    except FileNotFoundError:
        return ""
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text; save it as UTF-8") from None


def read_json(path: Path) -> Mapping[str, Any]:
    """Return the JSON object in a file.

    Raises:
        NoRun: the file does not exist, or has no JSON object.
    """
    try:
        found = json.loads(text_of(read_in(path.parent, path.name)))
    except (OSError, ValueError, RecursionError) as error:
        raise NoRun(f"{path}: cannot read the summary of a run: {error}") from None
    if not isinstance(found, dict):
        raise NoRun(f"{path}: must be a JSON object")
    return found
