"""The bench over REST: devices, homing, tare, moving by hand, and the virtual lab's loads and faults."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import ConfigDict, Field

from core.control.controllers import INNER_LOOPS, STRATEGIES
from station.config.controllers import ControllerFile
from station.config.strict import Strict
from station.control.jog import Space
from station.control.messages import DeviceStatus
from station.control.states import RefusedError
from station.lab.faults import KINDS, LabFault, Part, check_faults
from station.lab.loads import Load
from station.service.audit import Audit, Entry
from station.service.station_service import JOG_TIP_SPEED, JOG_TURN_SPEED, StationService
from web.api.commands import Commands, aside
from web.api.schemas import REFUSED, DoneOut, StartOut


class JointOut(Strict):
    """A joint and what its stage allows."""

    name: str
    motion: Literal["rotation", "translation"]
    unit: str
    lower: float
    upper: float
    speed: float


class BenchOut(Strict):
    """What stands there."""

    robot: str
    lab: str
    """what is simulated, or which drivers are in use"""
    virtual: bool
    """a virtual lab: it can be pulled at and its devices can be made to fail"""
    joints: tuple[JointOut, ...]
    working_pose: Mapping[str, float] | None
    """where the station goes after homing [rad or m]; null: it stays there"""
    tubes: tuple[str, ...]
    """innermost first"""
    tip_speed: float
    """of the tip when it is moved by hand, at most [m/s]"""
    turn_speed: float | None
    """of where it points, when that is turned by hand, at most [rad/s]; null: that is not controlled here"""
    strategies: tuple[str, ...]
    """of control"""
    inner: tuple[str, ...]
    """laws of the inner loop"""
    controller: ControllerFile
    """of a free motion unless it brings another"""


class DevicesOut(Strict):
    """All devices, and the newest of what they measure."""

    devices: tuple[DeviceStatus, ...]
    raw: Mapping[str, float]
    """by channel, as in recordings, with the unit in the name"""


class HomeIn(Strict):
    """A person's word."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"way_is_clear": True}]})

    way_is_clear: Literal[True]
    """somebody has looked: the tubes can be retracted and turned without touching anything"""
    then_working_pose: bool = True
    """go on to the working pose, where the robot's file has one; false: stay where homing ends"""


class GotoIn(Strict):
    """A pose in joints to go to, at half their top speed and no faster."""

    model_config = ConfigDict(json_schema_extra={"examples": [{}, {"joints": {"inner_translation": -0.08}}]})

    joints: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """by name [rad or m]; what is not named stays; left out: the working pose of the robot's file"""


class JogIn(Strict):
    """A movement by hand, for the next 0.3 s; ask again to go on."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"space": "tip", "velocity": [0.0, 0.0, 0.002]}]})

    space: Space
    velocity: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=20)]
    """of every joint [rad/s or m/s], or, world frame, of the tip [m/s] or of where it points [rad/s]"""


class PullIn(Strict):
    """A load for the simulated tip or shaft, from now on."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"load": {"kind": "constant", "magnitude": 0.2}}]})

    load: Load


class FaultsIn(Strict):
    """Faults of the simulated devices, from now on."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"faults": [{"kind": "mute", "device": "tracker", "duration": 1.0}]}]}
    )

    faults: Annotated[tuple[LabFault, ...], Field(strict=False, min_length=1, max_length=20)]


class FaultKindOut(Strict):
    """What can be injected."""

    kind: str
    devices: tuple[str, ...]
    """whom it can befall"""
    most: float | None
    """of its value; null: it has none"""
    unit: str
    lasts: bool
    """it has a duration"""


#: Channels that come straight from a device.
RAW = ("joints", "velocity_commanded", "velocity_sent", "wrench_raw", "tip_measured", "tip_time", "force", "moment")


def bench_routes(service: StationService, of: Commands, audit: Audit) -> APIRouter:
    """Routes under /api that are about the bench."""
    router = APIRouter(prefix="/api", tags=["bench"], dependencies=[Depends(of.heard)])
    operator = [Depends(of.needed)]
    supervisor = service.supervisor

    def done() -> DoneOut:
        return DoneOut(state=supervisor.status().state.name)

    async def in_a_virtual_lab() -> None:
        if supervisor.bench.devices is not None:
            raise RefusedError("this bench has real devices; only a virtual lab can be pulled at or made to fail")

    virtual = [Depends(in_a_virtual_lab), *operator]

    @router.get("/bench", summary="Robot, joints and their limits")
    def bench() -> BenchOut:
        return bench_out(service)

    @router.get("/devices", summary="Every device with its details, and raw values")
    def devices() -> DevicesOut:
        return devices_out(service)

    @router.get("/log", summary="Commands and refusals, the newest first")
    def log(count: Annotated[int, Query(ge=1, le=1000)] = 100) -> list[Entry]:
        return list(audit.tail(count))

    @router.post("/connect", responses=REFUSED, dependencies=operator, summary="Find the devices")
    async def connect() -> DoneOut:
        await aside(supervisor.connect)
        return done()

    @router.post("/home", responses=REFUSED, dependencies=operator, summary="Home every stage")
    async def home(word: HomeIn) -> DoneOut:
        await aside(partial(service.home, then_work=word.then_working_pose))
        return done()

    @router.post("/goto", status_code=202, responses=REFUSED, dependencies=operator, summary="Go to a pose in joints")
    async def goto(request: GotoIn) -> StartOut:
        run = await aside(service.go_to, request.joints)
        return StartOut(run_id=run.id, warnings=run.start.warnings)

    @router.post("/tare", responses=REFUSED, dependencies=operator, summary="Zero the force sensors")
    async def tare() -> DoneOut:
        await aside(supervisor.tare)
        return done()

    @router.post("/jog", responses=REFUSED, dependencies=operator, summary="Move by hand while this is repeated")
    async def jog(request: JogIn) -> DoneOut:
        await aside(service.jog, request.space, request.velocity)
        return done()

    @router.post("/pull", responses=REFUSED, dependencies=virtual, summary="Pull at the simulated robot (virtual lab)")
    async def pull(request: PullIn) -> DoneOut:
        await aside(service.apply_load, request.load)
        return done()

    @router.get("/faults", summary="Faults that can be injected (virtual lab)")
    def faults() -> list[FaultKindOut]:
        return fault_kinds(service)

    @router.post("/faults", responses=REFUSED, dependencies=virtual, summary="Let devices fail (virtual lab)")
    async def inject(request: FaultsIn) -> DoneOut:
        check_faults(request.faults, supervisor.bench.robot)
        await aside(supervisor.inject, request.faults)
        return done()

    @router.delete("/faults", responses=REFUSED, dependencies=virtual, summary="Mend injected faults (virtual lab)")
    async def mend() -> DoneOut:
        await aside(supervisor.inject, ())
        return done()

    return router


def bench_out(service: StationService) -> BenchOut:
    """The bench for a reader."""
    bench = service.supervisor.bench
    return BenchOut(
        robot=bench.robot.name,
        lab=bench.title,
        virtual=bench.devices is None,
        joints=tuple(
            JointOut(
                name=joint.name,
                motion=joint.motion,
                unit="rad" if joint.motion == "rotation" else "m",
                lower=joint.lower,
                upper=joint.upper,
                speed=joint.speed,
            )
            for joint in bench.robot.joints
        ),
        working_pose=bench.robot.working_pose,
        tubes=tuple(tube.name for tube in bench.robot.tubes),
        tip_speed=JOG_TIP_SPEED,
        turn_speed=None if bench.controller.task == "position" else JOG_TURN_SPEED,
        strategies=tuple(STRATEGIES),
        inner=tuple(INNER_LOOPS),
        controller=bench.controller,
    )


def devices_out(service: StationService) -> DevicesOut:
    """The devices for a reader; values that are not known yet, or any more, are left out."""
    status = service.supervisor.status()
    raw: dict[str, float] = {}
    for group in RAW:
        if group in status.values and group not in status.standing:
            names = [c.column for c in service.supervisor.channels.all if c.name.rsplit(".", 1)[0] == group]
            raw |= {name: x for name, x in zip(names, status.values[group].tolist(), strict=True) if x == x}
    return DevicesOut(
        devices=status.devices,
        raw=raw,
    )


def fault_kinds(service: StationService) -> list[FaultKindOut]:
    """Every kind of fault and whom it can befall on this bench."""
    robot = service.supervisor.bench.robot
    whom: dict[Part, tuple[str, ...]] = {
        "stages": ("stages",),
        "joint": tuple(joint.name for joint in robot.joints),
        "tracker": ("tracker",),
        "sensor": ("sensors", *(tube.name for tube in robot.tubes)),
    }
    return [
        FaultKindOut(
            kind=name,
            devices=tuple(device for part in kind.parts for device in whom[part]),
            most=kind.most,
            unit=kind.unit,
            lasts=kind.lasts,
        )
        for name, kind in KINDS.items()
    ]
