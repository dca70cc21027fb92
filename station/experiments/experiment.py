"""Experiments as TOML files: a start pose, a motion, a load, a controller, and cases that vary them."""

import itertools
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from core.control.controllers import PositionMode
from core.control.step import Controller
from core.errors import CtrError, Unreachable
from core.robot.robot import Array
from station.config.controllers import ControllerFile
from station.config.motions import Motion, Orders
from station.config.robots import RobotFile, load_robot, start_pose
from station.config.strict import (
    PRESETS,
    ConfigError,
    Format,
    Name,
    NotNegative,
    Row,
    Strict,
    check,
    merged,
    on_line,
    preset,
    read_toml,
)
from station.control.known_calibration import Calibration
from station.devices.aurora.tracker import Registration
from station.lab.config import LabConfig, load_lab
from station.lab.faults import LabFault, check_faults
from station.lab.loads import Load, NoLoad
from station.recording.tracking_errors import counted_from

#: Of one experiment.
MOST_CASES = 1000


class PaperNumbers(Strict):
    """What the paper reports, by axis or model; only what it reports."""

    max_abs_error_mm: Mapping[str, float] = {}
    model_error_mm: Mapping[str, float] = {}


class CaseFile(Strict):
    """One case of an experiment, everything filled in."""

    format: Format = 1
    """of this file"""
    title: str
    """in words, for page and report"""
    robot: str = "paper"
    """preset, or a .toml file beside this one"""
    lab: str = "gentle"
    """virtual lab: preset or file"""
    start: Mapping[str, float]
    """joint positions [rad or m]"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """of the motion [s]"""
    settling: NotNegative
    """errors count from here on, or from the load's onset if that is earlier [s]"""
    trajectory: Motion
    """what the tip is to do"""
    load: Load = NoLoad()
    """what pulls meanwhile"""
    controller: ControllerFile = ControllerFile()
    """how the tip is controlled"""
    calibration: str = ""
    """folder with what `calibrate` found; without, everything is taken to be as described"""
    faults: Annotated[tuple[LabFault, ...], Row] = ()
    """what goes wrong at the simulated devices"""

    @property
    def counted_from(self) -> float:
        """When errors begin to count [s]."""
        return counted_from(self.settling, self.load.onset)


class Case(NamedTuple):
    """A case ready to run."""

    name: str
    file: CaseFile
    robot: RobotFile
    lab: LabConfig
    controller: Controller
    orders: Orders
    start: Array  #: (n,) [rad or m]
    registration: Registration | None = None  #: of the tracker, from a calibration
    warnings: tuple[str, ...] = ()  #: what the joints cannot make up for


class Experiment(NamedTuple):
    """An experiment ready to run."""

    name: str
    title: str
    cases: tuple[Case, ...]
    paper: Mapping[str, PaperNumbers]  #: by case
    source: str  #: the file's text, kept with the results


class _PaperTable(Strict):
    paper: Mapping[str, PaperNumbers]


class _CasesTable(Strict):
    cases: Mapping[Name, Mapping[str, Any]] = {}
    cross: Mapping[Name, Annotated[Mapping[Name, Mapping[str, Any]], Field(min_length=1)]] = {}


def load_experiment(name: str, changes: Mapping[str, Any] | None = None) -> Experiment:
    """An experiment by preset name or by file, all of it checked before anything runs.

    Args:
        name: of a preset, or a file.
        changes: laid on top of every case.

    Raises:
        ConfigError: with file, case, key, value and what was expected.
    """
    path = preset("experiments", name)
    table = read_toml(path)
    paper = check(_PaperTable, {"paper": table.pop("paper", {})}, str(path)).paper
    listed = {key: table.pop(key, {}) for key in ("cases", "cross")}
    asked = check(_CasesTable, listed, str(path))
    if (count := len(asked.cases) + math.prod(map(len, asked.cross.values())) * bool(asked.cross)) > MOST_CASES:
        raise ConfigError(
            f"{path}: {count} cases; at most {MOST_CASES} are taken, which are tried on the model one by one before"
            " anything runs: divide them among several files"
        )
    variations = variants(asked.model_dump()) or {path.stem: {}}
    cases: list[Case] = []
    tried: dict[str, tuple[str, ...]] = {}
    for case, variation in variations.items():
        cases.append(_case(path, case, merged(merged(table, variation), changes or {}), table, tried))
    if unknown := [case for case in paper if case not in variations]:
        raise ConfigError(f"{path}: paper.{unknown[0]} is not one of the cases: {', '.join(variations)}")
    return Experiment(path.stem, str(table.get("title", "")), tuple(cases), paper, table.text)


def variants(table: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What each case of an experiment's table changes, by its name.

    These are its `cases`; and of its `cross`, which has several choices on each of several axes, every combination,
    named by its choices from the first axis to the last.
    """
    found = {name: dict(changes) for name, changes in table.get("cases", {}).items()}
    axes = [axis.items() for axis in table.get("cross", {}).values()]
    for choice in itertools.product(*axes) if axes else ():
        changes: dict[str, Any] = {}
        for _, part in choice:
            changes = merged(changes, part)
        found[crossed(*(name for name, _ in choice))] = changes
    return found


def crossed(*names: str) -> str:
    """Name of the case that combines these choices."""
    return "-".join(names)


_shipped = cache(load_experiment)


def offered(name: str) -> Experiment:
    """A preset or one's own, for a station that runs: what comes with the station is tried on the model only once.

    One's own is read anew each time: it may have been edited meanwhile.

    Raises:
        ConfigError: as `load_experiment`.
    """
    return _shipped(name) if preset("experiments", name).is_relative_to(PRESETS) else load_experiment(name)


def _case(
    path: Path, name: str, table: Mapping[str, Any], document: Mapping[str, Any],
    tried: dict[str, tuple[str, ...]],
) -> Case:  # fmt: skip
    """One case, whose settings are in `table`, of the file that is `document`.

    `tried` are motions known to be good, and what their loads are warned of.
    """
    source, within = f"{path}: case '{name}'", f"cases.{name}"
    file = check(CaseFile, _paths_beside(path, table), source, document, within)
    robot = load_robot(file.robot)
    lab = load_lab(file.lab, robot)
    try:
        start = start_pose(file.start, robot)
        check_faults(file.faults, robot)
        if file.faults and lab.devices == "ideal":
            raise ConfigError(f"faults: the devices of lab '{file.lab}' are ideal and have none; choose another lab")
        calibration = Calibration.load(Path(file.calibration), robot) if file.calibration else None
        # The lab's true robot differs from the one described, whatever is found out about it.
        controller = file.controller.controller(robot if calibration is None else calibration.robot)
        if calibration is not None:
            controller = calibration.applied(controller)
        controller.limits.check(start)
        controller.statics.robot.check_pose(start)
        orders = Orders(file.trajectory, controller.statics.robot)
        if orders.follow is not None and lab.target is None:
            raise ConfigError(
                f"trajectory.kind = 'follow': lab '{file.lab}' has no target; choose one with a table [target],"
                " for instance 'breathing'"
            )
        # Cases that differ in nothing that the way depends on try it once.
        settings = (file.controller.sublink, file.controller.task, file.controller.direction_weight)
        way = repr((file.robot, file.calibration, settings, file.start, file.trajectory, file.duration))
        if way not in tried:
            orders.check(controller, start, file.duration)
            tried[way] = ()
        if isinstance(controller.strategy.outer, PositionMode) and file.load.changes:
            way += repr(file.load)
            if way not in tried:
                tried[way] = load_warnings(orders, controller, start, file.duration, file.load)
    except CtrError as error:
        raise ConfigError(f"{source}: {error}{on_line(document, str(error), within)}") from None
    registration = None if calibration is None else calibration.registration
    return Case(name, file, robot, lab, controller, orders, start, registration, tried[way])


def load_warnings(orders: Orders, controller: Controller, start: Array, duration: float, load: Load) -> tuple[str, ...]:
    """What a person should know of a load: when it is first more than the joints can make up for, and which limit.

    A load is a disturbance, not a wish, and so never refused. Empty when the joints can, where the tip is not
    controlled in its position anyway, and of a load beside the tip, which is not tried.
    """
    if not isinstance(controller.strategy.outer, PositionMode) or math.isfinite(load.contact):
        return ()
    try:
        orders.check(controller, start, duration, load.force)
    except Unreachable as error:
        return (f"load {load.kind} is more than the joints can make up for: {error}",)
    return ()


def _paths_beside(path: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with the files that it names where it means them: beside itself."""

    def placed(holder: Mapping[str, Any], key: str, ending: str) -> dict[str, Any]:
        named = holder.get(key)
        if isinstance(named, str) and named.endswith(ending):
            return {**holder, key: str(path.parent / named)}
        return dict(holder)

    result = placed(placed(table, "robot", ".toml"), "lab", ".toml")
    if result.get("calibration"):
        result = placed(result, "calibration", "")
    if isinstance(motion := result.get("trajectory"), Mapping):
        result["trajectory"] = placed(motion, "file", "")
    return result
