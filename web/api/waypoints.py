"""REST routes for motions that the page defines: check waypoints on the model, save and load motions as experiments."""

import asyncio
from collections.abc import Mapping
from pathlib import Path as FilePath
from threading import Event
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from pydantic import ConfigDict, Field

from station.config.controllers import ControllerFile
from station.config.loads import Load, NoLoad
from station.config.motions import Places
from station.config.robots import named_pose
from station.config.strict import Name, Strict, Vector
from station.control.states import RefusedError
from station.experiments.saved import FreeMotion, SavedAlreadyError, save, saved_motion
from station.service.rig import Rig
from station.service.station_service import StationService
from station.service.waypoint_check import FeasibilityResult, check_waypoints
from web.api.cancel_on_disconnect import cancel_on_disconnect
from web.api.commands import Commands, run_in_thread
from web.api.schemas import REFUSED_RESPONSES, DoneOut, TipMotionIn


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


def waypoint_routes(service: StationService, data: FilePath, of: Commands) -> APIRouter:
    """Return the routes under /api. Experiments are saved in `data` unless the station's file names a folder."""
    router = APIRouter(prefix="/api", tags=["experiments"], dependencies=[Depends(of.renew_lease)])
    operator = [Depends(of.require_operator)]
    bench = service.supervisor.bench
    one_at_a_time = asyncio.Lock()  # one check at a time, because it uses a whole processor

    def pose(joints: Mapping[str, float] | None) -> dict[str, float]:
        """Return joint positions by name [rad or m]: the given `joints`, or the present positions if `joints` is None.

        Raises:
            RefusedError: the present joints are unknown.
            CtrError: a joint is unknown, missing or not a number.
        """
        names = service.supervisor.robot.joint_names
        if joints is None:
            values = service.supervisor.status().values
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
        start = named_pose(pose(request.start), bench.robot, "start")
        controller = bench.controlled(request.controller or service.settings.controller)
        cancelled = Event()

        async def work() -> FeasibilityResult:
            async with one_at_a_time:
                return await run_in_thread(check_waypoints, request, controller, start, cancelled.is_set)

        try:
            found = await cancel_on_disconnect(connection, work())
        finally:
            cancelled.set()  # ends the check in its thread, because cancelling a task does not stop a thread
        return WaypointCheckOut(
            possible=not found.reason, reason=found.reason, place=found.place, instead=found.instead,
            path=tuple((x, y, z) for x, y, z in found.path.tolist()),
        )  # fmt: skip

    @router.put(
        "/experiments/{name}",
        responses=REFUSED_RESPONSES,
        dependencies=operator,
        summary="Save a free motion as an experiment",
    )
    async def put(name: Name, request: SaveIn) -> DoneOut:
        motion = FreeMotion(
            title=request.title.strip() or name.replace("_", " "),
            start=pose(request.start),
            duration=request.duration,
            trajectory=request.trajectory,
            controller=request.controller or service.settings.controller,
            load=request.load,
        )
        try:
            path = await run_in_thread(lambda: save(motion, name, data, _made_for(bench), replace=request.replace))
        except SavedAlreadyError as error:
            raise RefusedError(str(error)) from None
        return DoneOut(state=service.supervisor.status().state.name, note=f"saved as {path}")

    @router.get(
        "/experiments/{name}/motion", responses=REFUSED_RESPONSES, summary="An experiment's first case as a free motion"
    )
    def get_motion(name: Name) -> FreeMotion:
        return saved_motion(name)

    return router


def _made_for(bench: Rig) -> dict[str, str]:
    """Return robot, lab and calibration of this station as keys of an experiment file."""
    named = {"robot": bench.robot_name, "lab": bench.lab_name}
    found = {key: str(FilePath(to).absolute()) if to.endswith(".toml") else to for key, to in named.items() if to}
    folder = None if bench.calibration is None else bench.calibration.folder
    return found if folder is None else found | {"calibration": str(folder.absolute())}
