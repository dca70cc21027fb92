"""Motions that are made on the page: tried on the model before they start, kept as experiments, and taken up again."""

import asyncio
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import ConfigDict, Field

from station.config.controllers import ControllerFile
from station.config.motions import Places
from station.config.robots import named_pose
from station.config.strict import Name, Strict, Vector
from station.control.states import RefusedError
from station.experiments.saved import FreeMotion, SavedAlreadyError, save, saved_motion
from station.lab.loads import Load, NoLoad
from station.service.bench import Bench
from station.service.station_service import StationService
from station.service.tried import try_places
from web.api.commands import Commands, aside
from web.api.schemas import REFUSED, DoneOut, TipMotionIn


class TryIn(Places):
    """Places to be tried from where the robot is, or from another pose."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"points": [[0, 0, 0, 0], [5, 0, 0.005, 0]]}]})

    start: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """pose in which it would begin [rad or m]; where the joints are now when left out"""
    controller: ControllerFile | None = None
    """that would follow; as set before when left out"""


class TryOut(Strict):
    """Whether the tip gets there."""

    possible: bool
    reason: str
    """why not; empty when it is possible"""
    place: int | None
    """the first that is not got to, from 0; null when it is none of them that is in the way"""
    instead: str
    """what would work; empty when nothing that was tried does"""
    path: tuple[Vector, ...]
    """the smooth way through the places, from the start tip [m]; empty when there is none"""


class SaveIn(Strict):
    """A free motion to be kept as an experiment."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"trajectory": {"kind": "waypoints", "points": [[5.0, 0.0, 0.005, 0.0]]}, "duration": 8.0}]
        }
    )

    trajectory: TipMotionIn
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """[s]"""
    start: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """pose in which it begins [rad or m]; where the joints are now when left out"""
    controller: ControllerFile | None = None
    """as set before when left out"""
    load: Load = NoLoad()
    title: Annotated[str, Field(max_length=200)] = ""
    """for a person; made of the name when empty"""
    replace: bool = False
    """the experiment of that name, if there is one"""


def taught_routes(service: StationService, data: FilePath, of: Commands) -> APIRouter:
    """Routes under /api; experiments are kept in the folder of `data` where the station's file names no other."""
    router = APIRouter(prefix="/api", tags=["experiments"], dependencies=[Depends(of.heard)])
    operator = [Depends(of.needed)]
    bench = service.supervisor.bench
    one_at_a_time = asyncio.Lock()  # it takes a processor

    def pose(asked: Mapping[str, float] | None) -> dict[str, float]:
        """The joints asked for, else those of now [rad or m], by name.

        Raises:
            RefusedError: nobody knows where they are.
            CtrError: a joint is unknown, missing or no number.
        """
        names = service.supervisor.robot.joint_names
        if asked is None:
            values = service.supervisor.status().values
            if "joints" not in values:
                raise RefusedError("start is missing, and where the joints are is not known; connect and home first")
            return dict(zip(names, values["joints"].tolist(), strict=True))
        return dict(zip(names, named_pose(asked, bench.robot, "start").tolist(), strict=True))

    @router.post("/try", responses=REFUSED, summary="Whether the tip gets to these places; nothing moves")
    async def try_(request: TryIn) -> TryOut:
        start = named_pose(pose(request.start), bench.robot, "start")
        controller = bench.controlled(request.controller or service.settings.controller)
        async with one_at_a_time:
            found = await aside(try_places, request, controller, start)
        return TryOut(
            possible=not found.reason, reason=found.reason, place=found.place, instead=found.instead,
            path=tuple((x, y, z) for x, y, z in found.path.tolist()),
        )  # fmt: skip

    @router.put(
        "/experiments/{name}", responses=REFUSED, dependencies=operator, summary="Keep a free motion as an experiment"
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
            path = await aside(lambda: save(motion, name, data, _made_for(bench), replace=request.replace))
        except SavedAlreadyError as error:
            raise RefusedError(str(error)) from None
        return DoneOut(state=service.supervisor.status().state.name, note=f"saved as {path}")

    @router.get("/experiments/{name}/motion", responses=REFUSED, summary="An experiment's first case as a free motion")
    def get_motion(name: Name) -> FreeMotion:
        return saved_motion(name)

    return router


def _made_for(bench: Bench) -> dict[str, str]:
    """Robot, lab and calibration of this station, as an experiment's file names them."""
    named = {"robot": bench.robot_name, "lab": bench.lab_name}
    found = {key: str(FilePath(to).absolute()) if to.endswith(".toml") else to for key, to in named.items() if to}
    folder = None if bench.calibration is None else bench.calibration.folder
    return found if folder is None else found | {"calibration": str(folder.absolute())}
