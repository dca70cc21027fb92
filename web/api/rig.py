"""The rig over REST: robot, joints, devices, and the faults that a virtual lab offers."""

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query

from core.control.controllers import INNER_LOOPS, STRATEGIES
from station.config.controllers import ControllerFile
from station.config.plugins import installed
from station.config.robots import load_robot
from station.config.strict import Strict, preset_names
from station.control.commands import JOG_TIP_SPEED_M_S, JOG_TURN_SPEED_RAD_S
from station.control.messages import DeviceStatus
from station.lab.faults import FAULT_KINDS, Part
from station.recording.run_outcome import KNOWN_STD_N
from station.service.audit import Audit, Entry
from station.service.supervisor import Supervisor
from web.api.commands import Commands
from web.api.files import FileThreads


class JointOut(Strict):
    """A joint and the limits of its stage."""

    name: str
    motion: Literal["rotation", "translation"]
    unit: str
    lower: float
    upper: float
    speed: float


#: Keys of a joint in the robot's file that are part of the response.
JOINT_KEYS = ("name", "motion", "lower", "upper", "speed")


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
    """largest desired force of a motion `force` [N]; it is below `max_force`, because the force at the contact may be
    half as large again as desired"""
    known_force_std: float
    """standard deviation above which a component of the force is shown as unknown [N]"""
    model: str
    """integrator of the controller's model, and length of its sub-links"""
    tip_speed: float
    """speed limit of the tip while it is jogged [m/s]"""
    turn_speed: float | None
    """limit of the tip's turning speed while it is jogged [rad/s]; null: the tip's direction is not controlled"""
    strategies: tuple[str, ...]
    """names of the control strategies and of installed outer loops"""
    inner: tuple[str, ...]
    """names of the inner loops"""
    loads: tuple[str, ...]
    """names of the installed loads"""
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
    """newest value of each telemetry channel; the names are those of the recordings and contain the unit"""


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


def bench_routes(supervisor: Supervisor, of: Commands, audit: Audit, files: FileThreads) -> APIRouter:
    """Return the routes under /api for the rig."""
    router = APIRouter(prefix="/api", tags=["bench"], dependencies=[Depends(of.renew_lease)])

    @router.get("/rig", summary="Robot, joints and their limits")
    def bench() -> RigOut:
        """Return robot, joints and limits, which do not change while the station runs."""
        bench = supervisor.bench
        force = bench.best_known_robot.largest_force()
        return RigOut(
            robot=bench.robot.name,
            lab=bench.title,
            virtual=bench.devices is None,
            joints=tuple(
                JointOut(unit="rad" if joint.motion == "rotation" else "m", **joint.model_dump(include=set(JOINT_KEYS)))
                for joint in bench.robot.joints
            ),
            can_track_target=bench.can_track_target,
            working_pose=bench.robot.working_pose,
            tubes=tuple(tube.name for tube in bench.robot.tubes),
            max_force=force.newton,
            max_force_reason=force.reason,
            max_desired_force=bench.max_desired_force,
            known_force_std=KNOWN_STD_N,
            model=bench.model_note,
            tip_speed=JOG_TIP_SPEED_M_S,
            turn_speed=None if bench.controller.task == "position" else JOG_TURN_SPEED_RAD_S,
            strategies=(*STRATEGIES, *installed("outer_loops")),
            inner=(*INNER_LOOPS, *installed("inner_loops")),
            loads=installed("loads"),
            controller=bench.controller,
        )

    @router.get("/robots", summary="Preset robots and how many motors they have")
    def robots() -> tuple[RobotOut, ...]:
        """List the preset robots; `ctr-station serve --robot NAME` starts a virtual lab with one of them."""
        return _preset_robots()

    @router.get("/devices", summary="Every device with its details, and raw values")
    def devices() -> DevicesOut:
        """Return all devices and their newest values; unknown and stale values are omitted."""
        return devices_out(supervisor)

    @router.get("/log", summary="Commands and refusals, newest first")
    async def log(count: Annotated[int, Query(ge=1, le=1000)] = 100) -> list[Entry]:
        """Return the newest log entries; every changing request has one, with sender, address and outcome."""
        return list(await files.run(audit.tail, count))

    @router.get("/faults", summary="Faults that can be injected (virtual lab)")
    def faults() -> list[FaultKindOut]:
        """List the kinds of faults, each with the devices that it can affect and the bound of its value."""
        robot = supervisor.bench.robot
        targets: dict[Part, tuple[str, ...]] = {
            "stages": ("stages",),
            "joint": tuple(joint.name for joint in robot.joints),
            "tracker": ("tracker",),
            "sensor": ("sensors", *robot.sensor_names),
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

    return router


def devices_out(supervisor: Supervisor) -> DevicesOut:
    """Return the state of all devices as a response; unknown or stale values are omitted."""
    status = supervisor.status()
    raw: dict[str, float] = {}
    for group in RAW_CHANNELS:
        if group in status.values and group not in status.stale_groups:
            names = [c.column for c in supervisor.channels.all if c.name.rsplit(".", 1)[0] == group]
            raw |= {name: x for name, x in zip(names, status.values[group].tolist(), strict=True) if x == x}
    return DevicesOut(devices=status.devices, raw=raw)
