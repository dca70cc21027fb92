"""A run as its folder has it: the summary, the experiment's file, and every case's rows by group of channels."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.strict import merged, read_toml
from station.control.task import Phase
from station.control.telemetry import Channel
from station.experiments.experiment import variants
from station.recording.read import open_case
from station.recording.tracking_errors import desired

#: Groups of channels that reports and players show.
KEPT = frozenset((
    "time", "phase", "joints", "force", "force_filtered", "force_true", "tip_new", "tip_time", "tip_measured",
    "tip_estimated", "tip_unloaded", "tip_desired", "tip_observed", "truth_known", "tip_true", "deflection",
    "deflection_rate_raw", "deflection_rate", "deflection_rate_exact", "delta_1", "delta_2",
    "target_followed", "target_measured", "target_offset", "target_true",
))  # fmt: skip
#: Rows of a case that are kept in memory; a recording of more than 33 minutes is thinned out.
MOST = 1_000_000
#: What a live run calls its only case; which one of an experiment it is stands in its recording.
LIVE = "run"


class NoRun(CtrError):
    """A folder that holds no run that a report could be made of."""


@dataclass(frozen=True)
class Case:
    """One case of a run."""

    name: str
    channels: Sequence[Channel]
    rows: Array  #: (ticks, channels)
    file: Mapping[str, Any]  #: the experiment's table with this case's changes
    numbers: Mapping[str, Any]  #: its part of the summary
    metadata: Mapping[str, Any]
    stride: int = 1  #: every n-th tick is here

    def of(self, group: str) -> Array:
        """The columns of a group, e.g. `tip_measured`: (ticks, 3).

        Raises:
            NoRun: the recording has no such channels.
        """
        at = [number for number, channel in enumerate(self.channels) if channel.name.rsplit(".", 1)[0] == group]
        if not at:
            raise NoRun(f"case '{self.name}' has no channels '{group}'; was it recorded by another version?")
        return self.rows[:, at[0] : at[-1] + 1]

    def names(self, group: str) -> list[str]:
        """What the columns of a group are called, the group's name left out."""
        parts = (channel.name.rsplit(".", 1) for channel in self.channels)
        return [part[1] for part in parts if len(part) == 2 and part[0] == group]

    @property
    def words(self) -> str:
        """Which case it is, for a title; empty for a free motion, which has no other."""
        named = str(self.metadata.get("case", "" if self.name == LIVE else self.name))
        return f" (case {named.replace('_', ' ')})" if named else ""

    @property
    def time(self) -> Array:
        """(ticks,) since the motion's start [s]."""
        return self.of("time")[:, 0]

    @property
    def counted_from(self) -> float:
        """Errors count from here on [s]; in older runs that is the settling time, whatever the load did."""
        return float(self.numbers.get("counted_from_s", self.file.get("settling", 0.0)))

    @property
    def truth_known(self) -> bool:
        """Whether a virtual lab said where the tip really was."""
        return bool(self.of("truth_known").all())

    @property
    def sweeps(self) -> bool:
        """Whether a joint was turned, with no path for the tip."""
        return self.file.get("trajectory", {}).get("kind") == "joint_sweep"

    @property
    def moved(self) -> bool:
        """Whether its motion began; older recordings do not say that it did not."""
        return all(channel.name != "phase" for channel in self.channels) or bool(
            (self.of("phase") == Phase.MOVING).any()
        )

    @property
    def follows(self) -> bool:
        """Whether a target said where the tip should be."""
        return self.file.get("trajectory", {}).get("kind") == "follow"

    @property
    def settled_from(self) -> float:
        """What is left of a beginning is over here [s]."""
        return float(self.file.get("settling", 0.0))

    def beside(self) -> Array:
        """(ticks, 3) where the tip should be [m]: at the setpoint, or at the offset from a true target."""
        return desired(self.of, "target_true") if self.follows else self.of("tip_desired")

    def true_error(self) -> Array:
        """(ticks, 3) desired minus the plant's tip [mm]."""
        return 1e3 * (self.beside() - self.of("tip_true"))

    def measured_error(self) -> tuple[Array, Array]:
        """Desired minus measured of every tracker frame, at the time it was taken: (f,) [s] and (f, 3) [mm]."""
        new = self.of("tip_new")[:, 0] > 0.0
        at = self.of("tip_time")[new, 0]
        if self.follows:  # both were measured in the same frame
            return at, 1e3 * (desired(self.of, "target_measured") - self.of("tip_measured"))[new]
        wanted = np.stack([np.interp(at, self.time, column) for column in self.of("tip_desired").T], axis=1)
        return at, 1e3 * (wanted - self.of("tip_measured")[new])


@dataclass(frozen=True)
class Run:
    """A run with all that its folder says about it."""

    folder: Path
    experiment: str
    summary: Mapping[str, Any]
    table: Mapping[str, Any]  #: the experiment's file
    cases: tuple[Case, ...]  #: those with rows

    @property
    def simulated(self) -> bool:
        """Whether a virtual lab stood in for the bench."""
        return any(case.truth_known for case in self.cases)

    def case(self, name: str) -> Case | None:
        """The case of that name, if it has rows."""
        return next((case for case in self.cases if case.name == name), None)

    def paper(self, case: str, quantity: str) -> Mapping[str, float]:
        """The paper's numbers for a case; a case on the distorted tracker is held against the same ones."""
        return self.table.get("paper", {}).get(case.removesuffix("_distorted"), {}).get(quantity, {})


def read_run(folder: Path) -> Run:
    """All of a run that a report needs.

    Raises:
        NoRun: neither a recording nor a summary is there, or the summary is not JSON.
        ConfigError: the experiment's file cannot be read.
        RecordingError: a recording cannot be read.
    """
    recordings = sorted(folder.glob("*.mcap"))
    if not recordings and not (folder / "summary.json").is_file():
        raise NoRun(f"{folder}: no run in this folder: neither a recording (.mcap) nor summary.json")
    summary = read_json(folder / "summary.json") if (folder / "summary.json").is_file() else {}
    table = read_toml(folder / "experiment.toml") if (folder / "experiment.toml").is_file() else {}
    cases = [case for path in recordings if len((case := _read_case(path, table, summary)).rows)]
    order = list(summary.get("cases", {}))
    cases.sort(key=lambda case: order.index(case.name) if case.name in order else len(order))
    return Run(folder, str(summary.get("experiment", folder.name)), summary, table, tuple(cases))


def _read_case(path: Path, table: Mapping[str, Any], summary: Mapping[str, Any]) -> Case:
    """The channels that reports show; of a very long recording every n-th row."""
    name = path.stem
    with open_case(path) as recording:
        columns = [at for at, channel in enumerate(recording.channels) if channel.name.rsplit(".", 1)[0] in KEPT]
        stride = -(-recording.ticks // MOST)
        rows, before = [np.empty((0, len(columns)))], 0
        for block in recording.blocks():
            rows.append(block[-before % stride :: stride, columns] if stride > 1 else block[:, columns])
            before += len(block)
        channels = [recording.channels[at] for at in columns]
        file = merged(table, variants(table).get(name, {}))
        numbers = summary.get("cases", {}).get(name, {})
        whole = _of_the_motion(np.concatenate(rows), channels, float(numbers.get("motion_start", 0.0)))
        # A live run brings its settings with its recording.
        file = file or {"settling": numbers.get("settling", 0.0), **recording.metadata.get("settings", {})}
        return Case(name, channels, whole, file, numbers, recording.metadata, max(stride, 1))


def _of_the_motion(rows: Array, channels: Sequence[Channel], start: float) -> Array:
    """The motion of a live run, its times counted from its start; all rows where it never began.

    Args:
        rows: (ticks, channels).
        channels: of the rows.
        start: of the motion, as the summary says [s]; a run that was recovered has none there.
    """
    names = [channel.name for channel in channels]
    times = rows[:, names.index("time")]
    if "phase" in names and (moving := rows[:, names.index("phase")] == Phase.MOVING).any():
        start = float(times[moving][0])
    elif start != 0.0:
        moving = times >= start
    else:
        return rows
    kept = rows[moving]
    if start != 0.0:
        for name in ("time", "tip_time"):
            kept[:, names.index(name)] -= start
    return kept


def read_json(path: Path) -> Mapping[str, Any]:
    """A JSON object.

    Raises:
        NoRun: there is none, or it is something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise NoRun(f"{path}: no summary of a run there: {error}") from None
    if not isinstance(found, dict):
        raise NoRun(f"{path}: a JSON object was expected")
    return found
