"""The rig over REST: devices, homing, tare, jogging, and the virtual lab's loads and faults."""

import asyncio
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import ConfigDict, Field

from core.control.controllers import INNER_LOOPS, STRATEGIES
from station.config.controllers import ControllerFile
from station.config.loads import Load
from station.config.robots import load_robot
from station.config.strict import Strict, preset_names
from station.control.messages import DeviceStatus
from station.control.states import RefusedError
from station.control.task import Space
from station.lab.faults import FAULT_KINDS, LabFault, Part, check_faults
from station.service.audit import Audit, Entry
from station.service.station_service import JOG_TIP_SPEED_M_S, JOG_TURN_SPEED_RAD_S, StationService
from web.api.commands import Commands, Permitted
from web.api.schemas import DoneOut, StartOut


class JointOut(Strict):
    """A joint and the limits of its stage."""

    name: str
    motion: Literal["rotation", "translation"]
    unit: str
    lower: float
    upper: float
    speed: float


class RobotOut(Strict):
    """A preset robot, with which `ctr-station serve --robot NAME` starts a virtual lab."""

    name: str
    motors: int


class RigOut(Strict):
    """The rig: robot, joints, limits and controllers."""

    robot: str
    lab: str
    """name of the virtual lab, or the drivers in use"""
    virtual: bool
    """true: the rig is a virtual lab, which accepts simulated loads and device faults"""
    joints: tuple[JointOut, ...]
    can_track_target: bool
    """true: the tracker can measure a moving target, which motions of kind `follow` need"""
    working_pose: Mapping[str, float] | None
    """pose to which the robot moves after homing [rad or m]; null: the robot stays at the homing pose"""
    tubes: tuple[str, ...]
    """names of the tubes, innermost first"""
    max_force: float
    """force on the tip at which a motion ends in HOLD, or the tip moves no further against the force [N]"""
    max_force_reason: str
    """which part of the robot `max_force` protects, or which key sets it"""
    max_desired_force: float
    """largest desired force of a motion `force` [N]; it is below `max_force`, because the force at the contact exceeds
    the desired one by up to a half"""
    model: str
    """integrator of the model if the station chose it for the curvature of the tubes; empty: the paper's integrator, or
    the one of the station's file"""
    tip_speed: float
    """speed limit of the tip while it is jogged [m/s]"""
    turn_speed: float | None
    """limit of the tip's turning speed while it is jogged [rad/s]; null: the tip's direction is not controlled"""
    strategies: tuple[str, ...]
    """names of the control strategies"""
    inner: tuple[str, ...]
    """names of the inner loops"""
    controller: ControllerFile
    """controller of a free motion whose request specifies no controller"""


@cache
def _preset_robots() -> tuple[RobotOut, ...]:
    """Return all preset robots. Reading their files takes half a second, so they are read at the first request."""
    robots = (load_robot(name) for name in preset_names("robots"))
    return tuple(RobotOut(name=robot.name, motors=len(robot.joints)) for robot in robots)


class DevicesOut(Strict):
    """All devices, and their newest measurements."""

    devices: tuple[DeviceStatus, ...]
    raw: Mapping[str, float]
    """newest values by telemetry channel; a name is that of the recordings and contains the unit"""


class HomeIn(Strict):
    """The operator's confirmation for homing."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"way_is_clear": True}]})

    way_is_clear: Literal[True]
    """the operator has checked that the tubes can be retracted and turned without touching anything"""
    then_working_pose: bool = True
    """true: after homing go to the working pose, if the robot's file has one; false: stay at the homing pose"""


class GotoIn(Strict):
    """A joint pose to which the robot moves; each joint moves at most at half of its top speed."""

    model_config = ConfigDict(json_schema_extra={"examples": [{}, {"joints": {"inner_translation": -0.08}}]})

    joints: Annotated[Mapping[str, float], Field(min_length=1, max_length=20)] | None = None
    """joint positions by name [rad or m]; omitted joints do not move; null: the working pose of the robot's file"""


class JogIn(Strict):
    """A jog velocity that applies for 0.3 s; repeat the request to continue the jog."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"space": "tip", "velocity": [0.0, 0.0, 0.002]}]})

    space: Space
    velocity: Annotated[tuple[float, ...], Field(strict=False, min_length=1, max_length=20)]
    """velocity of every joint [rad/s or m/s]; or, in the world frame, of the tip [m/s] or of its direction [rad/s]"""


class LoadIn(Strict):
    """A load on the simulated tip or shaft, effective immediately."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"load": {"kind": "constant", "magnitude": 0.2}}]})

    load: Load


class FaultsIn(Strict):
    """Faults of the simulated devices, effective immediately."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"faults": [{"kind": "mute", "device": "tracker", "duration": 1.0}]}]}
    )

    faults: Annotated[tuple[LabFault, ...], Field(strict=False, min_length=1, max_length=20)]


class FaultKindOut(Strict):
    """A kind of fault that can be injected."""

    kind: str
    effect: str
    """what the fault does, as a sentence"""
    devices: tuple[str, ...]
    """devices or joints that it can affect"""
    most: float | None
    """largest value of the fault; null: the fault has no value"""
    unit: str
    lasts: bool
    """whether the fault has a duration"""


#: Names of the telemetry channels that contain unprocessed values of a device.
RAW_CHANNELS = (
    "joints", "velocity_commanded", "velocity_sent", "wrench_raw", "tip_measured", "tip_time", "force", "moment",
)  # fmt: skip


def bench_routes(service: StationService, of: Commands, audit: Audit) -> APIRouter:
    """Return the routes under /api for the rig."""
    router = APIRouter(prefix="/api", tags=["bench"], dependencies=[Depends(of.renew_lease)])
    supervisor = service.supervisor

    def done() -> DoneOut:
        return DoneOut(state=supervisor.status().state.name)

    async def in_a_virtual_lab() -> None:
        if supervisor.bench.devices is not None:
            raise RefusedError("this rig has real devices; only a virtual lab accepts simulated loads and faults")

    virtual: dict[str, Any] = of.command | {"dependencies": [Depends(in_a_virtual_lab), Depends(of.require_operator)]}

    @router.get("/rig", summary="Robot, joints and their limits")
    def bench() -> RigOut:
        bench = supervisor.bench
        force = bench.robot.largest_force()
        return RigOut(
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
            can_track_target=bench.can_track_target,
            working_pose=bench.robot.working_pose,
            tubes=tuple(tube.name for tube in bench.robot.tubes),
            max_force=force.newton,
            max_force_reason=force.reason,
            max_desired_force=bench.max_desired_force,
            model=bench.model_note,
            tip_speed=JOG_TIP_SPEED_M_S,
            turn_speed=None if bench.controller.task == "position" else JOG_TURN_SPEED_RAD_S,
            strategies=tuple(STRATEGIES),
            inner=tuple(INNER_LOOPS),
            controller=bench.controller,
        )

    @router.get("/robots", summary="Preset robots and how many motors they have")
    def robots() -> tuple[RobotOut, ...]:
        return _preset_robots()

    @router.get("/devices", summary="Every device with its details, and raw values")
    def devices() -> DevicesOut:
        return devices_out(service)

    @router.get("/log", summary="Commands and refusals, newest first")
    def log(count: Annotated[int, Query(ge=1, le=1000)] = 100) -> list[Entry]:
        return list(audit.tail(count))

    @router.post("/connect", summary="Find the devices", **of.command)
    async def connect(permit: Permitted) -> DoneOut:
        await asyncio.to_thread(supervisor.connect, permit)
        return done()

    @router.post("/home", summary="Home every stage", **of.command)
    async def home(request: HomeIn, permit: Permitted) -> DoneOut:
        await asyncio.to_thread(service.home, then_work=request.then_working_pose, permit=permit)
        return done()

    @router.post("/goto", status_code=202, summary="Go to a joint pose", **of.command)
    async def goto(request: GotoIn, permit: Permitted) -> StartOut:
        run = await asyncio.to_thread(service.go_to, request.joints, permit=permit)
        return StartOut(run_id=run.id, warnings=run.start.warnings)

    @router.post("/tare", summary="Zero the force sensors", **of.command)
    async def tare(permit: Permitted) -> DoneOut:
        await asyncio.to_thread(supervisor.tare, permit)
        return done()

    @router.post("/jog", summary="Jog for 0.3 s; repeat to continue", **of.command)
    async def jog(request: JogIn, permit: Permitted) -> DoneOut:
        await asyncio.to_thread(service.jog, request.space, request.velocity, permit=permit)
        return done()

    @router.post("/load", summary="Apply a load to the simulated robot (virtual lab)", **virtual)
    async def apply_load(request: LoadIn) -> DoneOut:
        await asyncio.to_thread(service.apply_load, request.load)
        return done()

    @router.get("/faults", summary="Faults that can be injected (virtual lab)")
    def faults() -> list[FaultKindOut]:
        robot = supervisor.bench.robot
        targets: dict[Part, tuple[str, ...]] = {
            "stages": ("stages",),
            "joint": tuple(joint.name for joint in robot.joints),
            "tracker": ("tracker",),
            "sensor": ("sensors", *(tube.name for tube in robot.tubes)),
        }
        return [
            FaultKindOut(
                kind=name,
                effect=kind.effect,
                devices=tuple(device for part in kind.parts for device in targets[part]),
                most=kind.maximum,
                unit=kind.unit,
                lasts=kind.lasts,
            )
            for name, kind in FAULT_KINDS.items()
        ]

    @router.post("/faults", summary="Inject device faults (virtual lab)", **virtual)
    async def inject(request: FaultsIn) -> DoneOut:
        check_faults(request.faults, supervisor.bench.robot)
        await asyncio.to_thread(supervisor.inject, request.faults)
        return done()

    @router.delete("/faults", summary="Remove injected faults (virtual lab)", **virtual)
    async def remove_faults() -> DoneOut:
        await asyncio.to_thread(supervisor.inject, ())
        return done()

    return router


def devices_out(service: StationService) -> DevicesOut:
    """Return the state of all devices as a response; unknown or stale values are omitted."""
    status = service.supervisor.status()
    raw: dict[str, float] = {}
    for group in RAW_CHANNELS:
        if group in status.values and group not in status.stale_groups:
            names = [c.column for c in service.supervisor.channels.all if c.name.rsplit(".", 1)[0] == group]
            raw |= {name: x for name, x in zip(names, status.values[group].tolist(), strict=True) if x == x}
    return DevicesOut(devices=status.devices, raw=raw)
