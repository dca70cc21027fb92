"""Experiments as TOML files: each has a start pose, a motion, a load, a controller, and cases that vary these."""

import itertools
import math
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, cast

from pydantic import Field

from core.control.controller_settings import Controller
from core.control.controllers import PositionMode
from core.control.reachability import check_pose
from core.errors import CtrError, PoseError, Unreachable
from core.robot.robot import Array
from station.config.controllers import ControllerFile
from station.config.loads import Load, NoLoad, force_of
from station.config.motions import Motion, Orders, suited
from station.config.regions import Regions, mesh_hashes, mesh_warnings, read_regions
from station.config.robots import RobotFile, load_robot, start_pose
from station.config.strict import (
    PRESETS,
    ConfigError,
    Format,
    Line,
    Name,
    NotNegative,
    Row,
    Strict,
    check,
    is_shipped_preset,
    line_reference,
    merged,
    preset,
    read_toml,
)
from station.control.bench_calibration import BenchCalibration
from station.devices.aurora.tracker import TrackerMounting
from station.devices.cameras import CalibratedView
from station.experiments import checked_motions
from station.experiments.checked_motions import digest
from station.lab.config import LabConfig, LabName, Without, load_lab
from station.lab.faults import LabFault, check_faults
from station.lab.simulated_stages import lab_latency
from station.recording.run_outcome import counted_from

#: Largest number of cases in one experiment. It limits the waiting time, because each case is checked on the model
#: before anything runs.
MAX_CASES = 1000


class PaperNumbers(Strict):
    """Numbers that the paper reports for a case, by axis or model; numbers that it does not report are missing."""

    max_abs_error_mm: Mapping[str, float] = {}
    model_error_mm: Mapping[str, float] = {}


class CaseFile(Strict):
    """One case of an experiment, with the value of every key."""

    format: Format = 1
    """format of this file"""
    title: Line
    """title on the page and in the report"""
    robot: str = "paper"
    """preset, or a .toml file in the folder of this file"""
    lab: LabName = "gentle"
    """virtual lab: preset, file, or a table with other `stages`"""
    without: Without = ()
    """devices that the lab does not have in this case: tracker, sensors"""
    start: Mapping[str, float]
    """joint positions [rad or m]"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """duration of the motion [s]"""
    settling: NotNegative
    """errors count from this time on, or from the load's onset if that is earlier [s]"""
    trajectory: Motion
    """desired motion of the tip"""
    load: Load = NoLoad()
    """external load during the motion"""
    controller: ControllerFile = ControllerFile()
    """controller of the tip"""
    calibration: str = ""
    """folder of a result of `ctr-station calibrate`; if empty, no calibration is used"""
    faults: Annotated[tuple[LabFault, ...], Row] = ()
    """faults of the simulated devices"""
    keep_out: Regions = ()
    """regions that the tubes must not enter, or must not leave"""

    @property
    def counted_from(self) -> float:
        """Time after the motion's start from which errors count [s]."""
        return counted_from(self.settling, self.load.onset)


class Case(NamedTuple):
    """A checked case that is ready to run."""

    name: str
    file: CaseFile
    robot: RobotFile
    lab: LabConfig
    controller: Controller
    orders: Orders
    start: Array  #: (n,) [rad or m]
    registration: TrackerMounting | None = None  #: pose of the tracker relative to the robot, from a calibration
    warnings: tuple[str, ...] = ()  #: messages about loads that the joints cannot compensate
    #: Calibrated lenses and poses of the cameras that measure the tip.
    views: Mapping[str, CalibratedView] = MappingProxyType({})
    notices: tuple[
        str, ...
    ] = ()  #: messages about a robot file that changed since its calibration, and repaired meshes


class Experiment(NamedTuple):
    """A checked experiment that is ready to run."""

    name: str
    title: str
    cases: tuple[Case, ...]
    paper: Mapping[str, PaperNumbers]  #: numbers of the paper by case
    source: str  #: text of the file, stored with the results


class _PaperTable(Strict):
    paper: Mapping[str, PaperNumbers]


class _CasesTable(Strict):
    cases: Mapping[Name, Mapping[str, Any]] = {}
    cross: Mapping[Name, Annotated[Mapping[Name, Mapping[str, Any]], Field(min_length=1)]] = {}


def load_experiment(
    name: str, changes: Mapping[str, Any] | None = None, *, check_motions: bool = True, only: str | None = None
) -> Experiment:
    """Return an experiment by preset name or file, completely checked before anything runs.

    Args:
        name: name of a preset, or path of a file.
        changes: keys that are set in every case.
        check_motions: False: return a description only, without the check of the motions on the model, which takes
            seconds; a description must not be run.
        only: name of the only case to return and to check; None: all cases.

    Raises:
        ConfigError: the experiment is invalid, or has no case `only`; the message names file, case, key, value and the
            expected value.
    """
    path = preset("experiments", name)
    table = read_toml(path)
    paper = check(_PaperTable, {"paper": table.pop("paper", {})}, str(path)).paper
    listed = {key: table.pop(key, {}) for key in ("cases", "cross")}
    tables = check(_CasesTable, listed, str(path))
    if (count := len(tables.cases) + math.prod(map(len, tables.cross.values())) * bool(tables.cross)) > MAX_CASES:
        raise ConfigError(
            f"{path}: {count} cases; at most {MAX_CASES} are allowed, because each is checked on the model before"
            " anything runs: divide them among several files"
        )
    variations = variants(tables.model_dump()) or {path.stem: {}}
    if unknown := [case for case in paper if case not in variations]:
        raise ConfigError(f"{path}: paper.{unknown[0]} is not one of the cases: {', '.join(variations)}")
    if only is not None and only not in variations:
        raise ConfigError(f"--case {only}: the cases are {', '.join(variations)}")
    cases: list[Case] = []
    # Checks of motions with other changes are not stored, because their many values would fill the file.
    shipped = path.is_relative_to(PRESETS) and not (changes or {}).keys() - {"robot"}
    saved = checked_motions.read() if check_motions and shipped else None
    checked = dict(saved or {})
    for case, variation in variations.items():
        if only not in (None, case):
            continue
        changed = _at_working_pose(path, merged(table, variation), changes or {})
        cases.append(_case(path, case, changed, table, checked if check_motions else None))
    if saved is not None and checked != saved:
        checked_motions.write(checked)
    return Experiment(path.stem, str(table.get("title", "")), tuple(cases), paper, table.text)


def _at_working_pose(path: Path, table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a case with `changes`, and with the working pose of a changed robot.

    Only a case that starts at the working pose of its robot is adapted. It then starts at the working pose of the robot
    that `changes` set, if that robot has one.
    """
    changed = merged(table, changes)
    if "robot" in changes and "start" not in changes:
        described, robot = (load_robot(_resolve_paths(path, one).get("robot", "paper")) for one in (table, changed))
        if robot.working_pose is not None and table.get("start") == described.working_pose:
            changed["start"] = dict(robot.working_pose)
    return changed


def variants(table: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the keys that each case of an experiment's table changes, by the name of the case.

    The table `cases` lists cases. The table `cross` has several axes, each with several choices. Every combination of
    choices is a case; its name consists of the choices' names from the first axis to the last.
    """
    found = {name: dict(changes) for name, changes in table.get("cases", {}).items()}
    axes = [axis.items() for axis in table.get("cross", {}).values()]
    for choice in itertools.product(*axes) if axes else ():
        changes: dict[str, Any] = {}
        for _, part in choice:
            changes = merged(changes, part)
        found[crossed_name(*(name for name, _ in choice))] = changes
    return found


def crossed_name(*names: str) -> str:
    """Return the name of the case that combines the choices with these names."""
    return "-".join(names)


@cache
def _shipped(name: str, robot: str | None, check_motions: bool) -> Experiment:
    if robot is not None and robot != read_toml(preset("experiments", name)).get("robot", "paper"):
        named = str(Path(robot).absolute()) if robot.endswith(".toml") else robot
        with suppress(CtrError):  # this robot cannot carry out the experiment
            found = load_experiment(name, {"robot": named}, check_motions=check_motions)
            if all(case.file.start == case.robot.working_pose for case in found.cases):
                return found._replace(paper={})  # the paper has no numbers for this robot
    return load_experiment(name, check_motions=check_motions)


#: Locks by experiment, so that several requests wait for one check instead of repeating it.
_checking: defaultdict[tuple[str, str | None, bool], Lock] = defaultdict(Lock)


def is_shipped(name: str) -> bool:
    """Return whether an experiment belongs to this package; otherwise its file is the user's.

    Raises:
        ConfigError: there is no experiment of this name.
    """
    return is_shipped_preset("experiments", name)


def offered_experiment(name: str, robot: str | None = None, *, check_motions: bool = True) -> Experiment:
    """Return an experiment for a running station; an experiment preset is checked on the model only once.

    A preset that starts at the working pose of its robot is adapted to the station's `robot` (preset or file): it then
    starts at the working pose of this robot, if its motions are possible there.

    A user's file is read and checked each time, because it may have been edited. `check_motions` has the same meaning
    as in `load_experiment`.

    Raises:
        ConfigError: the experiment is invalid; the message is that of `load_experiment`.
    """
    with _checking[name, robot, check_motions]:
        if is_shipped(name):
            return _shipped(name, robot, check_motions)
        return load_experiment(name, check_motions=check_motions)


def _case(
    path: Path, name: str, table: Mapping[str, Any], document: Mapping[str, Any],
    checked: dict[str, tuple[str, ...]] | None,
) -> Case:  # fmt: skip
    """Return the case with the settings in `table`, from the file `document`.

    `checked` collects the motions that have passed the check, each with the warnings about its load. So cases with the
    same motion are checked once. None: no motion is checked.
    """
    source, within = f"{path}: case '{name}'", f"cases.{name}"
    file = check(CaseFile, _resolve_paths(path, table), source, document, within)
    robot = load_robot(file.robot)
    lab = load_lab(file.lab, robot).leaving_out(file.without)
    try:
        robot = robot.sensed_at(lab.sensors.at, f"lab '{file.lab}': sensors.at")
        file = file.model_copy(update={"keep_out": read_regions(file.keep_out)})
        start = start_pose(file.start, robot)
        check_faults(file.faults, robot)
        if file.faults and lab.devices == "ideal":
            raise ConfigError(f"faults: the devices of lab '{file.lab}' are ideal and have none; choose another lab")
        calibration = BenchCalibration.load(Path(file.calibration), robot, lab.cameras) if file.calibration else None
        # The controller gets the calibrated robot. The lab keeps simulating its own true robot, which differs from it.
        controller = suited(file.controller, file.trajectory).controller(
            robot if calibration is None else calibration.robot, lab.present, file.keep_out,
            lab_latency(lab.stages, robot),
        )  # fmt: skip
        if calibration is not None:
            controller = calibration.applied(controller)
        check_pose(controller.statics, controller.limits, start)
        orders = Orders(file.trajectory, controller.statics.robot)
        if orders.follow is not None and lab.target is None:
            raise ConfigError(
                f"trajectory.kind = 'follow': lab '{file.lab}' has no target; choose one with a table [target],"
                " for instance 'breathing'"
            )
        # Cases with the same rig and motion share one check.
        bench = (robot, lab.present, file.calibration, file.keep_out)
        settings = (
            file.controller.integrator,
            file.controller.sublink,
            file.controller.task,
            file.controller.direction_weight,
        )
        force_of(file.load, 0.0)
        registration = None if calibration is None else calibration.registration
        views = {} if calibration is None else calibration.views
        notices = (*(() if calibration is None else calibration.warnings), *mesh_warnings(file.keep_out))
        described = Case(name, file, robot, lab, controller, orders, start, registration, views=views, notices=notices)
        if checked is None:
            return described
        motion = digest(repr((bench, settings, file.start, file.trajectory, file.duration)))
        if meshes := mesh_hashes(file.keep_out):
            motion = digest(motion + repr(meshes))
        if motion not in checked:
            orders.check(controller, start, file.duration)
            checked[motion] = ()
        if isinstance(controller.strategy.outer, PositionMode) and file.load.changes:
            motion = digest(motion + repr(file.load))
            if motion not in checked:
                checked[motion] = load_warnings(orders, controller, start, file.duration, file.load)
    except CtrError as error:
        raise ConfigError(f"{source}: {error}{line_reference(document, str(error), within)}") from None
    return described._replace(warnings=checked[motion])


def load_warnings(orders: Orders, controller: Controller, start: Array, duration: float, load: Load) -> tuple[str, ...]:
    """Return a warning if the joints cannot compensate a load: from which time on, and which limit prevents it.

    A load is a disturbance, so it is never refused. No warning is returned if the joints can compensate the load, or if
    the controller does not control the tip's position. A load that does not act at the tip is not checked.
    """
    if not isinstance(controller.strategy.outer, PositionMode) or math.isfinite(load.contact):
        return ()
    try:
        orders.check(controller, start, duration, partial(force_of, load))
    except (Unreachable, PoseError) as error:
        return (f"the joints cannot compensate load {load.kind}: {error}",)
    return ()


def _resolve_paths(path: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a case's table in which file names are relative to the folder of the experiment's file."""

    def resolved(part: Mapping[str, Any], key: str, ending: str) -> dict[str, Any]:
        named = part.get(key)
        if isinstance(named, str) and named.endswith(ending):
            return {**part, key: str(path.parent / named)}
        return dict(part)

    result = resolved(resolved(table, "robot", ".toml"), "lab", ".toml")
    if isinstance(lab := result.get("lab"), Mapping):
        result["lab"] = resolved(lab, "base", ".toml")
    if result.get("calibration"):
        result = resolved(result, "calibration", "")
    if isinstance(motion := result.get("trajectory"), Mapping):
        result["trajectory"] = resolved(motion, "file", "")
    if isinstance(regions := result.get("keep_out"), list):
        result["keep_out"] = [
            resolved(one, "file", "") if isinstance(one, Mapping) else one for one in cast(list[Any], regions)
        ]
    return result
