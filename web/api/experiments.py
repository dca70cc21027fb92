"""Experiments over REST: descriptions and pictures of their cases, and motions that the page defines and saves."""

import asyncio
from collections.abc import Mapping
from pathlib import Path as FilePath
from threading import Event
from typing import Annotated, NamedTuple

import numpy as np
from fastapi import APIRouter, Depends, Request
from pydantic import ConfigDict, Field

from core.control.trajectories import Setpoint
from core.errors import CtrError
from core.robot.robot import Array
from station.config import palette
from station.config.controllers import ControllerFile
from station.config.loads import Load, NoLoad
from station.config.motions import Places
from station.config.robots import named_pose
from station.config.strict import Name, Strict, Vector, preset_names
from station.control.loop import MotionTask
from station.control.states import RefusedError
from station.experiments.case_summary import case_facts, case_words
from station.experiments.experiment import Case, is_shipped, offered_experiment
from station.experiments.saved import FreeMotion, SavedAlreadyError, save, saved_motion
from station.service.feasibility import FeasibilityResult, check_waypoints, deviations_from_case, incompatibility
from station.service.station_file import Rig
from station.service.supervisor import Supervisor
from web.api.commands import Commands, cancel_on_disconnect
from web.api.files import FileThreads
from web.api.schemas import REFUSED_RESPONSES, CaseOut, DoneOut, ExperimentOut, FactOut, TipMotionIn
from web.scene.content import path_offsets

#: Height of an experiment's picture [px]; the path and the load each fill a square.
PICTURE_PX = 72
MARGIN_PX = 8.0
#: Force at the top of the picture [N]; all pictures use the same scale, so that they can be compared.
MAX_FORCE_N = 0.5
#: Smallest width of a path's picture [m], so that a small step appears small.
MIN_SPAN_M = 0.02
SAMPLE_COUNT = 200


class _Plane(NamedTuple):
    horizontal: Array
    vertical: Array


#: Projection planes as in the scene. From the side, z points right and gravity (+x) down. The front
#: view, along z, is for a path that extends across the z axis.
_SIDE = _Plane(np.array((0.0, 0.0, 1.0)), np.array((1.0, 0.0, 0.0)))
_FRONT = _Plane(np.array((0.0, -1.0, 0.0)), np.array((1.0, 0.0, 0.0)))


def picture(case: Case) -> str:
    """Return an SVG of one case: the path at the left, the load's magnitude over time at the right."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * PICTURE_PX}" height="{PICTURE_PX}" viewBox="0 0'
        f' {2 * PICTURE_PX} {PICTURE_PX}">'
        f"{_path(case)}{_load(case)}</svg>"
    )


def _path(case: Case) -> str:
    middle = PICTURE_PX / 2
    cross = (
        f'<path d="M{MARGIN_PX} {middle}H{PICTURE_PX - MARGIN_PX}M{middle} {MARGIN_PX}V{PICTURE_PX - MARGIN_PX}"'
        f' stroke="#8a97a4" stroke-width=".6" opacity=".6"/>'
    )
    points = _points(case)
    if len(points) < 2:
        return cross + f'<circle cx="{middle}" cy="{middle}" r="4" fill="{palette.css(palette.DESIRED)}"/>'
    across = np.ptp(points[:, 1]) > np.ptp(points[:, 2])
    plane = _FRONT if across else _SIDE
    flat = np.stack((points @ plane.horizontal, points @ plane.vertical), axis=1)
    centre = (flat.max(axis=0) + flat.min(axis=0)) / 2
    span = max(float(np.ptp(flat, axis=0).max()), MIN_SPAN_M)
    shown = middle + (flat - centre) * ((PICTURE_PX - 2 * MARGIN_PX) / span)
    return cross + _polyline(shown, palette.css(palette.DESIRED), 2.5)


def _points(case: Case) -> Array:
    """Return points (k, 3) [m] of the desired path, or of the steps, relative to the tip at the start."""
    positions = [order.position for time in np.linspace(0.0, case.file.duration, SAMPLE_COUNT)
              if isinstance(order := case.orders.at(float(time)), Setpoint)]  # fmt: skip
    if not positions or np.ptp(np.array(positions), axis=0).max() < 1e-9:
        return np.empty((0, 3))
    jumps = np.linalg.norm(np.array(positions[0])) > 0.0
    if jumps:
        return np.array([np.zeros(3), *positions])
    return path_offsets(MotionTask(case.controller, case.orders, case.file.duration))


def _load(case: Case) -> str:
    times = np.linspace(0.0, case.file.duration, SAMPLE_COUNT)
    forces = np.array([np.linalg.norm(case.file.load.force(float(time))) for time in times])
    x = PICTURE_PX + MARGIN_PX + (PICTURE_PX - 2 * MARGIN_PX) * times / case.file.duration
    y = PICTURE_PX - MARGIN_PX - (PICTURE_PX - 2 * MARGIN_PX) * np.minimum(forces / MAX_FORCE_N, 1.0)
    left, right, bottom = PICTURE_PX + MARGIN_PX, 2 * PICTURE_PX - MARGIN_PX, PICTURE_PX - MARGIN_PX
    ground = f'<path d="M{left} {bottom}H{right}" stroke="#8a97a4" stroke-width=".6"/>'
    return ground + _polyline(np.stack((x, y), axis=1), palette.css(palette.FORCE), 2.0)


def _polyline(points: Array, colour: str, width: float) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>'


def experiments_out(bench: Rig, *, check_motions: bool) -> list[ExperimentOut]:
    """Return all experiments that a station with this rig offers; an invalid file is listed with its error.

    Without `check_motions` the answer does not wait for the check of the motions on the model.
    """
    return [_experiment_out(name, bench, check_motions) for name in preset_names("experiments")]


def _experiment_out(name: str, bench: Rig, check_motions: bool) -> ExperimentOut:
    group = "mine" if not is_shipped(name) else "paper" if name.startswith("fig") else "station"
    try:
        experiment = offered_experiment(name, bench.robot_name, check_motions=check_motions)
    except CtrError as error:
        return ExperimentOut(name=name, title="", cases=(), error=str(error), group=group, checked=check_motions)
    cases = tuple(_case_out(case, experiment.title, bench) for case in experiment.cases)
    return ExperimentOut(name=experiment.name, title=experiment.title, cases=cases, group=group, checked=check_motions)


def _case_out(case: Case, title: str, bench: Rig) -> CaseOut:
    file = case.file
    return CaseOut(
        name=case.name,
        words=case_words(case, title),
        duration=file.duration,
        strategy=file.controller.strategy,
        trajectory=file.trajectory.kind,
        load=file.load.kind,
        robot=case.robot.name,
        lab=str(file.lab),
        start=file.start,
        facts=tuple(FactOut(what=fact.what, text=fact.text) for fact in case_facts(case)),
        warnings=(*deviations_from_case(case, bench), *case.warnings),
        refused=incompatibility(case, bench),
    )


class WaypointCheckIn(Places):
    """Waypoints to check, starting from the present pose or from a given pose."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"points": [[0, 0, 0, 0], [5, 0, 0.005, 0]]}]})

    start: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """start pose [rad or m]; null: the present joints"""
    controller: ControllerFile | None = None
    """controller of the motion; null: the current setting"""


class WaypointCheckOut(Strict):
    """Whether the tip can follow the waypoints."""

    possible: bool
    reason: str
    """why the tip cannot follow the waypoints; empty if possible"""
    place: int | None
    """index of the first waypoint that cannot be reached, from 0; null: no single waypoint is the cause"""
    instead: str
    """an alternative that works; empty if no alternative was found"""
    path: tuple[Vector, ...]
    """smooth path through the waypoints, relative to the tip at the start [m]; empty if there is no path"""


class SaveIn(Strict):
    """A free motion to save as an experiment."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"trajectory": {"kind": "waypoints", "points": [[5.0, 0.0, 0.005, 0.0]]}, "duration": 8.0}]
        }
    )

    trajectory: TipMotionIn
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """duration of the motion [s]"""
    start: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """start pose [rad or m]; null: the present joints"""
    controller: ControllerFile | None = None
    """controller of the motion; null: the current setting"""
    load: Load = NoLoad()
    title: Annotated[str, Field(max_length=200)] = ""
    """title of the experiment; empty: derived from the name"""
    replace: bool = False
    """true: overwrite an existing experiment of that name"""


def waypoint_routes(supervisor: Supervisor, data: FilePath, of: Commands, files: FileThreads) -> APIRouter:
    """Return the routes of waypoints and experiments, which are saved in `data` unless the user has set a folder.

    All accesses to these folders use `files`.
    """
    router = APIRouter(prefix="/api", tags=["experiments"], dependencies=[Depends(of.renew_lease)])
    bench = supervisor.bench
    one_at_a_time = asyncio.Lock()  # one check at a time, because it uses a whole processor

    def pose(joints: Mapping[str, float] | None) -> dict[str, float]:
        """Return joint positions by name [rad or m]: the given `joints`, or the present positions if `joints` is None.

        Raises:
            RefusedError: the present joints are unknown.
            CtrError: a joint is unknown, missing or not a number.
        """
        names = supervisor.robot.joint_names
        if joints is None:
            values = supervisor.status().values
            if "joints" not in values:
                raise RefusedError("start is missing and the present joints are unknown; connect and home first")
            return dict(zip(names, values["joints"].tolist(), strict=True))
        return dict(zip(names, named_pose(joints, bench.robot, "start").tolist(), strict=True))

    @router.post(
        "/waypoints/check",
        responses=REFUSED_RESPONSES,
        summary="Check on the model whether the tip can follow waypoints; nothing moves",
    )
    async def check(request: WaypointCheckIn, connection: Request) -> WaypointCheckOut:
        """Check waypoints; the answer names the first point that the tip cannot reach, and the reason."""
        start = named_pose(pose(request.start), bench.robot, "start")
        controller = bench.controlled(request.controller or supervisor.settings.controller)
        cancelled = Event()

        async def work() -> FeasibilityResult:
            async with one_at_a_time:
                return await asyncio.to_thread(check_waypoints, request, controller, start, cancelled.is_set)

        try:
            found = await cancel_on_disconnect(connection, work())
        finally:
            cancelled.set()  # ends the check in its thread, because cancelling a task does not stop a thread
        return WaypointCheckOut(
            possible=not found.reason, reason=found.reason, place=found.place, instead=found.instead,
            path=tuple((x, y, z) for x, y, z in found.path.tolist()),
        )  # fmt: skip

    @router.put("/experiments/{name}", summary="Save a free motion as an experiment", **of.command)
    async def put(name: Name, request: SaveIn) -> DoneOut:
        """Save the motion in the user's folder of experiments; the name of a preset of the station is refused."""
        motion = FreeMotion(
            title=request.title.strip() or name.replace("_", " "),
            start=pose(request.start),
            duration=request.duration,
            trajectory=request.trajectory,
            controller=request.controller or supervisor.settings.controller,
            load=request.load,
        )
        try:
            path = await files.run(lambda: save(motion, name, data, _made_for(bench), replace=request.replace))
        except SavedAlreadyError as error:
            raise RefusedError(str(error)) from None
        return DoneOut(state=supervisor.status().state.name, note=f"saved as {path}")

    @router.get(
        "/experiments/{name}/motion", responses=REFUSED_RESPONSES, summary="An experiment's first case as a free motion"
    )
    async def get_motion(name: Name) -> FreeMotion:
        """Return the motion, which the page shows in a form where the operator can change it."""
        return await files.run(saved_motion, name)

    return router


def _made_for(bench: Rig) -> dict[str, str]:
    """Return robot, lab and calibration of this station as keys of an experiment file."""
    named = {"robot": bench.robot_name, "lab": bench.lab_name}
    found = {key: str(FilePath(to).absolute()) if to.endswith(".toml") else to for key, to in named.items() if to}
    folder = None if bench.calibration is None else bench.calibration.folder
    return found if folder is None else found | {"calibration": str(folder.absolute())}
