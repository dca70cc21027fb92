"""Calibration over REST: what can be found out, the procedure that is on, and what earlier ones have found."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field, model_validator
from starlette.exceptions import HTTPException

from station.calibration.catalogue import OFFERS, WEIGHTS
from station.calibration.exchange import checklist
from station.calibration.live import LiveCalibration
from station.calibration.report import NAME as REPORT
from station.calibration.results import Kept, NoResultError, Results
from station.config import Strict, preset_names
from station.robots import load_robot, robot_of
from web.commands import Commands, aside
from web.runs_api import STANDS_ALONE
from web.schemas import REFUSED, ErrorOut

MISSING: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such calibration or file"}}
What = Literal["axes", "latency", "tracker", "force", "tubes"]
#: Of a known weight [N].
Weight = Annotated[float, Field(ge=0.02, le=2.0)]


class OfferOut(Strict):
    """A procedure that can be begun."""

    name: str
    title: str
    sentence: str
    """when, and what happens"""
    needs: str
    """what a person has to have at hand"""
    seconds: float
    """of robot time at an effort of 1, persons' work included [s]"""
    scales: bool
    """an effort other than 1 means more or fewer poses"""
    weighs: bool
    """it asks for known weights"""


class CourseOut(Strict):
    """The procedure that is on, or the last one."""

    what: str
    on: bool
    """it has not ended"""
    stage: Literal["thinking", "moving", "asking", "done", "aborted", "failed"]
    done: float
    """part of it, 0 ... 1"""
    says: str
    """what is going on, or why it has ended"""
    asked: str
    """what a person is asked to do; empty when nothing"""
    hangs: float
    """known to hang at the tip, or to be hung there now [N]"""
    elapsed: float
    """[s]"""
    left: float
    """as expected [s]"""
    result: str
    """name of what was found; empty while there is nothing"""


class CalibrationOut(Strict):
    """What can be found out, and how it is getting on."""

    offers: tuple[OfferOut, ...]
    weights: tuple[float, ...]
    """usual known weights [N]"""
    robots: tuple[str, ...]
    """presets, for an exchange of tubes"""
    folder: str
    """where results go"""
    course: CourseOut | None


class CalibrateIn(Strict):
    """A procedure, and a person's word."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"what": "tracker", "effort": 1.0, "way_is_clear": True}]}
    )

    what: What
    effort: Annotated[float, Field(ge=0.5, le=5.0)] = 1.0
    """so many times the usual number of poses"""
    weights: Annotated[tuple[Weight, ...], Field(strict=False, min_length=1, max_length=4)] = WEIGHTS
    """that there are to hang at the tip [N]"""
    way_is_clear: Literal[True]
    """somebody has looked: the tubes can move through their whole workspace without touching anything"""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if len(set(self.weights)) < len(self.weights):
            raise ValueError("the weights must differ")
        return self


class UseOut(Strict):
    """How a result is put to use."""

    text: str
    line: str
    """at the top of the station's file; empty when there is none to be put there"""
    options: str
    """of ctr-station serve, for a station without a file"""


class KeptOut(Strict):
    """An earlier calibration at one look."""

    name: str
    procedure: str
    title: str
    made: str
    """ISO 8601"""
    bench: str
    simulated: bool
    """devices and robot were a virtual lab's"""
    findings: tuple[str, ...]
    """in words"""


class KeptDetailsOut(KeptOut):
    """An earlier calibration with its numbers."""

    found: tuple[Mapping[str, str], ...]
    """name, before, found, interval: half of 95 %"""
    visits: int
    robot_s: float
    """of robot time [s]"""
    files: tuple[str, ...]
    use: UseOut


class ExchangeIn(Strict):
    """The robot with other tubes: a preset, or what its file says."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"robot": "three_tubes"}]})

    robot: str | None = None
    """preset"""
    file: Annotated[str, Field(max_length=50_000)] | None = None
    """text of a robot's .toml file"""

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if (self.robot is None) == (self.file is None):
            raise ValueError("give either robot or file")
        return self


class TodoOut(Strict):
    """One line of the checklist."""

    procedure: str
    """to be carried out; empty: something that a person does"""
    text: str


class NowOut(Strict):
    """The procedure after a request."""

    course: CourseOut | None


def calibration_routes(calibration: LiveCalibration, of: Commands) -> APIRouter:
    """Routes under /api/calibration."""
    router = APIRouter(
        prefix="/api/calibration", tags=["calibration"], dependencies=[Depends(of.heard)], responses={422: REFUSED[422]}
    )
    operator = [Depends(of.needed)]
    results = Results(calibration.folder)

    def course() -> CourseOut | None:
        report = calibration.report
        if report is None:
            return None
        told = {key: value for key, value in report._asdict().items() if key not in ("effort", "stage")}
        return CourseOut(**told, stage=report.stage.value, on=report.on)

    @router.get("", summary="Procedures, and the one that is on")
    def calibrations() -> CalibrationOut:
        offers = tuple(
            OfferOut(name=name, **{key: getattr(offer, key) for key in OfferOut.model_fields if key != "name"})
            for name, offer in OFFERS.items()
        )
        robots = tuple(preset_names("robots"))
        return CalibrationOut(
            offers=offers, weights=WEIGHTS, robots=robots, folder=str(calibration.folder.absolute()), course=course()
        )

    @router.post(
        "/start", status_code=202, responses=REFUSED, dependencies=operator, summary="Begin a procedure; STOP ends it"
    )
    async def start(request: CalibrateIn) -> NowOut:
        await aside(calibration.start, request.what, request.effort, request.weights)
        return NowOut(course=course())

    @router.post("/done", responses=REFUSED, dependencies=operator, summary="What a person was asked for is done")
    async def done() -> NowOut:
        await aside(calibration.done)
        return NowOut(course=course())

    @router.post("/abort", responses=REFUSED, dependencies=operator, summary="End it; nothing of it is kept")
    async def abort() -> NowOut:
        await aside(calibration.abort)
        return NowOut(course=course())

    @router.post("/exchange", responses=REFUSED, summary="What has to be done after an exchange of tubes")
    def exchange(request: ExchangeIn) -> list[TodoOut]:
        file = request.file
        now = load_robot(_preset(request.robot or "")) if file is None else robot_of(file, "file")
        return [TodoOut(**todo._asdict()) for todo in checklist(calibration.supervisor.bench.robot, now)]

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
        "procedure": numbers["procedure"],
        "title": OFFERS[numbers["procedure"]].title,
        "made": numbers["made"],
        "bench": numbers["lab"],
        "simulated": numbers["simulated"],
        "findings": tuple(numbers["findings"]),
    }


def _details(kept: Kept) -> KeptDetailsOut:
    numbers = kept.numbers
    return KeptDetailsOut(
        **_listed(kept),
        found=tuple(numbers["found"]),
        visits=numbers["visits"],
        robot_s=numbers["robot_s"],
        files=kept.files,
        use=UseOut(**kept.use._asdict()),
    )
