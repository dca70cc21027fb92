"""Calibration over REST: available procedures, the running procedure, and stored results."""

import asyncio
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field, model_validator
from starlette.exceptions import HTTPException

from station.calibration.catalogue import DEFAULT_WEIGHTS_N, PROCEDURES
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
from web.api.runs import STANDALONE_POLICY
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

What = Literal["axes", "latency", "tracker", "force", "tubes"]
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
    """device that this bench lacks; then the procedure cannot be started; empty if it has all"""
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


class CalibrateIn(Strict):
    """A procedure to start, and the operator's confirmation."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"what": "tracker", "effort": 1.0, "way_is_clear": True}]}
    )

    what: What
    effort: Annotated[float, Field(ge=0.5, le=5.0)] = 1.0
    """factor on the default number of poses"""
    weights: Annotated[tuple[Weight, ...], Field(strict=False, min_length=1, max_length=4)] = DEFAULT_WEIGHTS_N
    """weights that the operator will hang at the tip [N]"""
    way_is_clear: Literal[True]
    """the operator has checked that the tubes can move through their whole workspace without touching anything"""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len(set(self.weights)) < len(self.weights):
            raise ValueError("the weights must differ")
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
    """The robot with other tubes: the name of a preset, or the text of a robot file."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"robot": "three_tubes"}]})

    robot: str | None = None
    """name of a preset robot"""
    file: Annotated[str, Field(max_length=50_000)] | None = None
    """text of a robot's .toml file"""

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.robot is None) == (self.file is None):
            raise ValueError("give either robot or file")
        return self


class CalibrationNowOut(Strict):
    """State of the procedure after a request."""

    course: SessionReport | None


NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such calibration or file"}}


def calibration_routes(calibration: LiveCalibration, of: Commands) -> APIRouter:
    """Return the REST routes under /api/calibration."""
    router = APIRouter(
        prefix="/api/calibration",
        tags=["calibration"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422]},
    )
    results = Results(calibration.folder)

    @router.get("", summary="Procedures, and the running one")
    def calibrations() -> CalibrationOut:
        present = calibration.supervisor.bench.present
        offers = tuple(
            ProcedureOut(
                name=name,
                missing=offer.missing(present),
                **{key: getattr(offer, key) for key in ProcedureOut.model_fields if key not in ("name", "missing")},
            )
            for name, offer in PROCEDURES.items()
        )
        robots = tuple(preset_names("robots"))
        return CalibrationOut(
            offers=offers,
            weights=DEFAULT_WEIGHTS_N,
            robots=robots,
            folder=str(calibration.folder.absolute()),
            course=calibration.report,
        )

    @router.post("/start", status_code=202, summary="Start a procedure; STOP ends it", **of.command)
    async def start(request: CalibrateIn, permit: Permitted) -> CalibrationNowOut:
        await asyncio.to_thread(calibration.start, request.what, request.effort, request.weights, permit)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/done", summary="Confirm that the requested manual step is done", **of.command)
    async def done() -> CalibrationNowOut:
        await asyncio.to_thread(calibration.done)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/abort", summary="Abort the procedure and discard its data", **of.command)
    async def abort() -> CalibrationNowOut:
        await asyncio.to_thread(calibration.abort)
        return CalibrationNowOut(course=calibration.report)

    @router.post("/exchange", responses=REFUSED_RESPONSES, summary="Steps to do after an exchange of tubes")
    def exchange(request: ExchangeIn) -> list[CheckItem]:
        file = request.file
        now = load_robot(_preset(request.robot or "")) if file is None else robot_of(file, "file")
        return connection_checklist(calibration.supervisor.bench.robot, now)

    @router.get("/results", summary="Stored calibrations, newest first")
    def stored() -> list[StoredCalibrationOut]:
        return [StoredCalibrationOut(**_summary(result)) for result in results.all()]

    @router.get("/results/{name}", responses=NOT_FOUND, summary="One stored calibration with its numbers")
    def one(name: str) -> StoredCalibrationDetailsOut:
        try:
            return _details(results.one(name))
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None

    @router.get(
        "/results/{name}/{file}",
        response_class=FileResponse,
        responses=NOT_FOUND,
        summary="A file of a calibration; report.html is the report",
    )
    def file(name: str, file: str) -> FileResponse:
        try:
            path = results.file(name, file)
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None
        if file == REPORT_FILE:
            return FileResponse(
                path, headers={"content-security-policy": STANDALONE_POLICY, "cache-control": "no-cache"}
            )
        return FileResponse(path, media_type="application/octet-stream", filename=f"{name}-{file}")

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
