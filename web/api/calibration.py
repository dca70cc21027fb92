"""Calibration over REST: available procedures, the running procedure, and stored results."""

import asyncio
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse, Response
from pydantic import ConfigDict, Field, model_validator
from starlette.exceptions import HTTPException

from station.calibration.catalogue import PROCEDURES, known_weights
from station.calibration.files import REPORT_FILE
from station.calibration.results import (
    CalibrationUse,
    CheckItem,
    NoResultError,
    Results,
    StoredCalibration,
    connection_checklist,
)
from station.config.robots import load_robot, robot_of
from station.config.strict import Strict, preset_names
from station.service.live_calibration import LiveCalibration, SessionReport
from web.api.commands import Commands, Permitted
from web.api.files import FileThreads, stored_file
from web.api.runs import STANDALONE_POLICY
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

What = Literal["axes", "latency", "tracker", "force", "tubes", "residual"]
#: A known weight to hang at the tip [N].
Weight = Annotated[float, Field(ge=0.02, le=2.0)]


class ProcedureOut(Strict):
    """A procedure that can be started."""

    name: str
    title: str
    sentence: str
    """when to use the procedure, and what it does"""
    needs: str
    """equipment that the operator needs"""
    missing: str
    """device that this rig lacks, so that the procedure cannot be started; empty if no device is missing"""
    seconds: float
    """duration with the default poses and weights, including manual steps [s]"""
    weight_seconds: float
    """part of `seconds` for each weight [s]"""
    scales: bool
    """whether `effort` changes the number of poses"""
    weighs: bool
    """whether the procedure needs known weights"""


class CalibrationOut(Strict):
    """Available procedures, and the progress of the running one."""

    offers: tuple[ProcedureOut, ...]
    weights: tuple[float, ...]
    """default weights [N]"""
    robots: tuple[str, ...]
    """names of the preset robots, from which an exchange of tubes can select"""
    folder: str
    """folder that contains the results"""
    course: SessionReport | None
    clearing: What
    """name of the procedure that reduces the distance between model and tracker"""
    in_use: str
    """folder of the calibration that the station uses; empty if it uses none"""
    file: str
    """station file to which a result is applied; empty: a result is applied until the program ends"""
    can_undo: bool
    """whether the last applied result can be undone"""


class CalibrateIn(Strict):
    """A procedure to start, and the operator's confirmation."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"what": "tracker", "effort": 1.0, "way_is_clear": True}]}
    )

    what: What
    effort: Annotated[float, Field(ge=0.5, le=5.0)] = 1.0
    """factor on the default number of poses"""
    weights: Annotated[tuple[Weight, ...], Field(strict=False, max_length=4)] = ()
    """weights that the operator will hang at the tip [N]; empty: 0.25 and 0.5 N, less if the robot bears less"""
    way_is_clear: Literal[True]
    """the operator has checked that the tubes can move through their whole workspace without touching anything"""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len(set(self.weights)) < len(self.weights):
            raise ValueError("two weights are equal; send different weights")
        return self


class StoredCalibrationOut(Strict):
    """Summary of a stored calibration."""

    name: str
    procedure: str
    title: str
    made: str
    """time of the calibration, ISO 8601"""
    bench: str
    simulated: bool
    """whether a virtual lab simulated devices and robot"""
    findings: tuple[str, ...]
    """human-readable results"""


class StoredCalibrationDetailsOut(StoredCalibrationOut):
    """A stored calibration with its numbers."""

    found: tuple[Mapping[str, str], ...]
    """one entry per parameter: name, value before, value found, interval (half width of the 95 % interval)"""
    visits: int
    robot_s: float
    """time for which the procedure used the robot [s]"""
    files: tuple[str, ...]
    use: CalibrationUse


class ExchangeIn(Strict):
    """The robot after an exchange of tubes: the name of a preset, or the text of a robot file."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"robot": "three_tubes"}]})

    robot: str | None = None
    """name of a preset robot"""
    file: Annotated[str, Field(max_length=50_000)] | None = None
    """text of a robot's .toml file"""

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.robot is None) == (self.file is None):
            raise ValueError("send either robot or file, not both")
        return self


class CalibrationNowOut(Strict):
    """State of the procedure after a request."""

    course: SessionReport | None


NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such calibration or file"}}


def calibration_routes(calibration: LiveCalibration, of: Commands, files: FileThreads) -> APIRouter:
    """Return the REST routes under /api/calibration. Stored calibrations are read in `files`."""
    router = APIRouter(
        prefix="/api/calibration",
        tags=["calibration"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422]},
    )
    results = Results(calibration.folder)

    @router.get("", summary="Procedures, and the running one")
    def calibrations() -> CalibrationOut:
        """List the procedures; `missing` names a device that this rig lacks, `course` is null before the first run."""
        present = calibration.supervisor.bench.present
        offers = tuple(
            ProcedureOut(
                name=name,
                missing=offer.missing(present),
                **{key: getattr(offer, key) for key in ProcedureOut.model_fields if key not in ("name", "missing")},
            )
            for name, offer in PROCEDURES.items()
        )
        known, choice = calibration.supervisor.bench.calibration, calibration.choice
        return CalibrationOut(
            offers=offers,
            weights=known_weights(calibration.supervisor.bench.best_known_robot),
            robots=tuple(preset_names("robots")),
            folder=str(calibration.folder.absolute()),
            course=calibration.report,
            clearing=calibration.clearing,
            in_use="" if known is None else str(known.folder),
            file="" if choice.file is None else str(choice.file),
            can_undo=choice.can_undo,
        )

    @router.post("/start", status_code=202, summary="Start a procedure; STOP ends it", **of.command)
    async def start(request: CalibrateIn, permit: Permitted) -> CalibrationNowOut:
        """Start a procedure, which reserves the robot and moves it through its whole workspace."""
        await asyncio.to_thread(calibration.start, request.what, request.effort, request.weights, permit)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/done", summary="Confirm that the requested manual step is done", **of.command)
    async def done() -> CalibrationNowOut:
        """Confirm the manual step for which the procedure waits, for example that a weight is attached."""
        await asyncio.to_thread(calibration.done)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/abort", summary="Abort the procedure and discard its data", **of.command)
    async def abort() -> CalibrationNowOut:
        """Stop the robot and discard the data of the procedure; then the robot accepts other commands."""
        await asyncio.to_thread(calibration.abort)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/exchange", responses=REFUSED_RESPONSES, summary="Steps to do after an exchange of tubes")
    def exchange(request: ExchangeIn) -> list[CheckItem]:
        """Compare the new tubes with the present tubes, and list the steps to do; the request changes nothing."""
        file = request.file
        now = load_robot(_preset(request.robot or "")) if file is None else robot_of(file, "file")
        return connection_checklist(calibration.supervisor.bench.robot, now)

    @router.get("/results", summary="Stored calibrations, newest first")
    async def stored() -> list[StoredCalibrationOut]:
        """List the stored calibrations, each with its time, its rig and its findings as sentences."""
        return [StoredCalibrationOut(**_summary(result)) for result in await files.run(results.all)]

    @router.get("/results/{name}", responses=NOT_FOUND, summary="One stored calibration with its numbers")
    async def one(name: str) -> StoredCalibrationDetailsOut:
        """Return one stored calibration; every number has its value before and after, and its 95 % interval."""
        try:
            return _details(await files.run(results.one, name))
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None

    @router.post(
        "/results/{name}/apply",
        status_code=202,
        summary="Use a stored calibration",
        responses=REFUSED_RESPONSES | NOT_FOUND,
        dependencies=of.command["dependencies"],
    )
    async def apply(name: str, permit: Permitted) -> None:
        """Set the calibration in the station file, or without a file for this session; then restart the station."""
        details = await one(name)
        await asyncio.to_thread(calibration.choose, calibration.folder / details.name, permit)

    @router.post("/undo", status_code=202, summary="Use the calibration before the last applied one", **of.command)
    async def undo(permit: Permitted) -> None:
        """Restore the earlier text of the station file, then restart the station."""
        await asyncio.to_thread(calibration.choose, None, permit)

    @router.get(
        "/results/{name}/{file}",
        response_class=FileResponse,
        responses=NOT_FOUND,
        summary="A file of a calibration; report.html is the report",
    )
    async def file(name: str, file: str) -> Response:
        """Return a file of a calibration; the details of the calibration list the names of its files."""
        try:
            path = await files.run(results.file, name, file)
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None
        if file == REPORT_FILE:
            headers = {"content-security-policy": STANDALONE_POLICY, "cache-control": "no-cache"}
            return await stored_file(files, path.parent, file, "text/html", headers=headers)
        return await stored_file(files, path.parent, file, "application/octet-stream", attachment=f"{name}-{file}")

    return router


def _preset(name: str) -> str:
    """Return the name of a preset robot. A path, which `load_robot` would also accept, is refused."""
    if name not in preset_names("robots"):
        raise NoResultError(f"'{name}' is not one of the robots: {', '.join(preset_names('robots'))}; or give its file")
    return name


def _summary(stored: StoredCalibration) -> dict[str, Any]:
    numbers = stored.numbers
    return {
        "name": stored.name,
        "procedure": numbers.procedure,
        "title": PROCEDURES[numbers.procedure].title,
        "made": numbers.made,
        "bench": numbers.lab,
        "simulated": numbers.simulated,
        "findings": tuple(numbers.findings),
    }


def _details(stored: StoredCalibration) -> StoredCalibrationDetailsOut:
    numbers = stored.numbers
    return StoredCalibrationDetailsOut(
        **_summary(stored),
        found=tuple(numbers.found),
        visits=numbers.visits,
        robot_s=numbers.robot_s,
        files=stored.files,
        use=stored.use,
    )
