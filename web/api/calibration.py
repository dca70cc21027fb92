"""Calibration over REST: what can be found out, the procedure that is on, and what earlier ones have found."""

from typing import Any

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException

from station.calibration.catalogue import OFFERS, WEIGHTS
from station.calibration.exchange import Todo, checklist
from station.calibration.folder import REPORT
from station.calibration.results import Kept, NoResultError, Results
from station.config.robots import load_robot, robot_of
from station.config.strict import preset_names
from station.service.live_calibration import LiveCalibration
from web.api.calibration_schemas import (
    CalibrateIn,
    CalibrationOut,
    ExchangeIn,
    KeptDetailsOut,
    KeptOut,
    NowOut,
    OfferOut,
)
from web.api.commands import Commands, aside
from web.api.runs import STANDS_ALONE
from web.api.schemas import REFUSED, ErrorOut

MISSING: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such calibration or file"}}


def calibration_routes(calibration: LiveCalibration, of: Commands) -> APIRouter:
    """Routes under /api/calibration."""
    router = APIRouter(
        prefix="/api/calibration", tags=["calibration"], dependencies=[Depends(of.heard)], responses={422: REFUSED[422]}
    )
    operator = [Depends(of.needed)]
    results = Results(calibration.folder)

    @router.get("", summary="Procedures, and the one that is on")
    def calibrations() -> CalibrationOut:
        offers = tuple(
            OfferOut(name=name, **{key: getattr(offer, key) for key in OfferOut.model_fields if key != "name"})
            for name, offer in OFFERS.items()
        )
        robots = tuple(preset_names("robots"))
        return CalibrationOut(
            offers=offers,
            weights=WEIGHTS,
            robots=robots,
            folder=str(calibration.folder.absolute()),
            course=calibration.report,
        )

    @router.post(
        "/start", status_code=202, responses=REFUSED, dependencies=operator, summary="Begin a procedure; STOP ends it"
    )
    async def start(request: CalibrateIn) -> NowOut:
        await aside(calibration.start, request.what, request.effort, request.weights)
        return NowOut(course=calibration.report)

    @router.post("/done", responses=REFUSED, dependencies=operator, summary="What a person was asked for is done")
    async def done() -> NowOut:
        await aside(calibration.done)
        return NowOut(course=calibration.report)

    @router.post("/abort", responses=REFUSED, dependencies=operator, summary="End it; nothing of it is kept")
    async def abort() -> NowOut:
        await aside(calibration.abort)
        return NowOut(course=calibration.report)

    @router.post("/exchange", responses=REFUSED, summary="What has to be done after an exchange of tubes")
    def exchange(request: ExchangeIn) -> list[Todo]:
        file = request.file
        now = load_robot(_preset(request.robot or "")) if file is None else robot_of(file, "file")
        return checklist(calibration.supervisor.bench.robot, now)

    @router.get("/results", summary="Earlier calibrations, the newest first")
    def kept() -> list[KeptOut]:
        return [KeptOut(**_listed(one)) for one in results.all()]

    @router.get("/results/{name}", responses=MISSING, summary="One of them with its numbers")
    def one(name: str) -> KeptDetailsOut:
        try:
            return _details(results.one(name))
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None

    @router.get(
        "/results/{name}/{file}",
        response_class=FileResponse,
        responses=MISSING,
        summary="A file of it; report.html is the report",
    )
    def file(name: str, file: str) -> FileResponse:
        try:
            path = results.file(name, file)
        except NoResultError as error:
            raise HTTPException(404, str(error)) from None
        if file == REPORT:
            return FileResponse(path, headers={"content-security-policy": STANDS_ALONE, "cache-control": "no-cache"})
        return FileResponse(path, media_type="application/octet-stream", filename=f"{name}-{file}")

    return router


def _preset(name: str) -> str:
    """A preset's name; never a path, which `load_robot` would take as well."""
    if name not in preset_names("robots"):
        raise NoResultError(f"'{name}' is not one of the robots: {', '.join(preset_names('robots'))}; or give its file")
    return name


def _listed(kept: Kept) -> dict[str, Any]:
    numbers = kept.numbers
    return {
        "name": kept.name,
        "procedure": numbers.procedure,
        "title": OFFERS[numbers.procedure].title,
        "made": numbers.made,
        "bench": numbers.lab,
        "simulated": numbers.simulated,
        "findings": tuple(numbers.findings),
    }


def _details(kept: Kept) -> KeptDetailsOut:
    numbers = kept.numbers
    return KeptDetailsOut(
        **_listed(kept),
        found=tuple(numbers.found),
        visits=numbers.visits,
        robot_s=numbers.robot_s,
        files=kept.files,
        use=kept.use,
    )
