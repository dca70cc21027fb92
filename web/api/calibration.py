"""Calibration over REST: available procedures, the running procedure, and stored results."""

from typing import Any

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException

from station.calibration.catalogue import DEFAULT_WEIGHTS_N, PROCEDURES
from station.calibration.exchange import CheckItem, connection_checklist
from station.calibration.folder import REPORT_FILE
from station.calibration.results import NoResultError, Results, StoredCalibration
from station.config.robots import load_robot, robot_of
from station.config.strict import preset_names
from station.service.live_calibration import LiveCalibration
from web.api.calibration_schemas import (
    CalibrateIn,
    CalibrationNowOut,
    CalibrationOut,
    ExchangeIn,
    ProcedureOut,
    StoredCalibrationDetailsOut,
    StoredCalibrationOut,
)
from web.api.commands import Commands, Permitted, run_in_thread
from web.api.runs import STANDALONE_POLICY
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such calibration or file"}}


def calibration_routes(calibration: LiveCalibration, of: Commands) -> APIRouter:
    """Return the REST routes under /api/calibration."""
    router = APIRouter(
        prefix="/api/calibration",
        tags=["calibration"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422]},
    )
    operator = [Depends(of.require_operator)]
    results = Results(calibration.folder)

    @router.get("", summary="Procedures, and the running one")
    def calibrations() -> CalibrationOut:
        offers = tuple(
            ProcedureOut(name=name, **{key: getattr(offer, key) for key in ProcedureOut.model_fields if key != "name"})
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

    @router.post(
        "/start",
        status_code=202,
        responses=REFUSED_RESPONSES,
        dependencies=operator,
        summary="Start a procedure; STOP ends it",
    )
    async def start(request: CalibrateIn, permit: Permitted) -> CalibrationNowOut:
        await run_in_thread(calibration.start, request.what, request.effort, request.weights, permit)
        return CalibrationNowOut(course=calibration.report)

    @router.post(
        "/done",
        responses=REFUSED_RESPONSES,
        dependencies=operator,
        summary="Confirm that the requested manual step is done",
    )
    async def done() -> CalibrationNowOut:
        await run_in_thread(calibration.done)
        return CalibrationNowOut(course=calibration.report)

    @router.post(
        "/abort", responses=REFUSED_RESPONSES, dependencies=operator, summary="Abort the procedure and discard its data"
    )
    async def abort() -> CalibrationNowOut:
        await run_in_thread(calibration.abort)
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
