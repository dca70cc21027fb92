"""Status of the station, for the page and for scripts: what it does, why, and what the operator can do next."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from core.control.force_control import Press
from station.camera.host import Cameras
from station.client import FORMAT
from station.config.loads import Load, NoLoad
from station.config.strict import Vector
from station.control.loop import Phase
from station.control.monitors import TAKE_OFF
from station.control.realtime import RELIEF, load
from station.control.states import LATCHED, State
from station.devices.interfaces import Condition, Severity
from station.experiments.case_summary import describe_keys
from station.service.contact import SideLoad
from station.service.status import STALE_AFTER_S, StationStatus
from station.service.supervisor import Supervisor
from web.access.identity import Role, Sender
from web.api.commands import Commands, operator_out
from web.api.schemas import Action, ContactOut, DeviceOut, LoopOut, RunOut, StatusOut


class StateMessage(NamedTuple):
    """Message that the page shows for the station's state."""

    message: str  #: what the station does, or why it has stopped
    next: str  #: what the operator should do; empty if nothing
    action: Action = ""  #: command or tab of the page that does what `next` says


_PHASES = {
    Phase.NONE: "starting",
    Phase.APPROACHING: "going to the start pose",
    Phase.SETTLING: "at rest: zeroing the force sensors, averaging the start tip",
    Phase.MOVING: "executing the trajectory",
    Phase.JOGGING: "jogging",
}
_IDLE_MESSAGES = {
    "OFF": StateMessage("devices are not connected", "connect the devices", "connect"),
    "CONNECTING": StateMessage(
        "finding and setting up the devices; the first start also compiles the model for a minute or more",
        "wait, or press STOP",
    ),
    "CONNECTED": StateMessage("devices are connected, positions are unknown", "home the stages", "home"),
    "HOMING": StateMessage("the stages search for their home sensors", "wait, or press STOP"),
    "HOMED": StateMessage("positions are known, the controller is starting", "wait"),
    "READY": StateMessage("nothing moves", "choose a motion and press Start", "start"),
}


class Reader(NamedTuple):
    """Properties of the client that reads a message, and of the rig that the message describes."""

    resets: bool = True  #: whether this client may reset the station
    operator: str | None = None  #: name of the operator; None: there is none
    views_only: bool = False  #: whether this client can only view the station and send STOP
    own_stop: str = ""  #: cause that the station reports for this client's own STOP; empty if it sent none
    simulated: bool = False  #: whether the devices are those of the virtual lab, where there is no rig to check
    removed_load: bool = False  #: whether the lab has removed its load, as it does at the end of every motion


#: What the robot does in a latched state. After a FAULT the cause itself reports what is known about the axes.
_CONSEQUENCES = {
    State.HOLD: "The robot keeps its position, and the motors are on.",
    State.STOPPED: "Every axis is at rest.",
}
#: A reset sends no velocity: the station becomes READY, or it connects devices again (`ControlLoop.reset`).
_RESET = "press Reset to make the station ready. Reset moves nothing."
_HOMING_KEYS = {"joint", "number", "of", "gone", "way", "exact", "unit", "left_s"}


def state_message(status: StationStatus, reader: Reader | None = None) -> StateMessage:
    """Return the message for the station's status; it reports missing telemetry in every state except OFF and FAULT."""
    state, reader = status.state, reader or Reader()
    if state is State.FAULT:
        return _latched(status, reader)
    if is_silent(status):
        return StateMessage(
            f"This computer is too busy: no telemetry for {status.age:.0f} s; the last state was {state.name}",
            f"press STOP; {RELIEF}; restart the station if this persists",
        )
    if state is State.RUNNING:
        if status.phase is Phase.APPROACHING and status.run is not None and not status.run.start.task.rests:
            return StateMessage(f"going {status.run.start.title}", "press STOP to end it")
        return StateMessage(_PHASES[status.phase], "")
    if state in LATCHED:
        return _latched(status, reader)
    if state is State.READY and status.reserved:
        return StateMessage(status.reserved, "follow it in the tab Calibrate", "calibrate")
    if state is State.HOMING:
        return _IDLE_MESSAGES[state.name]._replace(message=_homing(status) or _IDLE_MESSAGES[state.name].message)
    return _IDLE_MESSAGES[state.name]


def is_silent(status: StationStatus) -> bool:
    """Return whether expected telemetry is missing. OFF has none, and a FAULT reports its own cause."""
    return status.age > STALE_AFTER_S and status.state not in (State.OFF, State.FAULT)


def _latched(status: StationStatus, reader: Reader) -> StateMessage:
    """Return the message of HOLD, STOPPED and FAULT: the cause, what the robot does now, and who can reset."""
    cause = status.cause or "unknown cause"
    if reader.own_stop:
        cause = cause.replace(reader.own_stop, "you pressed STOP")
    if reader.removed_load:
        cause = cause.replace(
            TAKE_OFF, "the lab has taken the load off, so the tip has sprung back; if the force stays, "
        )
    text = f"{cause[0].upper()}{cause[1:]}"
    if status.state in _CONSEQUENCES:
        text = f"{text}. {_CONSEQUENCES[status.state]}"
    if reader.resets:
        first = [] if reader.simulated else ["check the rig"]
        if status.state is State.FAULT:
            first.insert(0, "remove the cause")
        step = f"{' and '.join(first)}, then {_RESET}" if first else _RESET
        return StateMessage(text, f"{step[0].upper()}{step[1:]}", "reset")
    who = "An operator" if reader.operator is None else f"'{reader.operator}'"
    step = "can reset the station." if reader.views_only else "can reset the station. Take over to reset it yourself."
    return StateMessage(text, f"{who} {step}", "reset")


def _homing(status: StationStatus) -> str:
    """Return the homing axis, its distance and the time left; empty if the driver does not report all of them."""
    homing = next((device.details.get("homing") for device in status.devices if device.name == "stages"), None)
    if not isinstance(homing, Mapping) or not homing.keys() >= _HOMING_KEYS:
        return ""
    scale, unit = (1e3, "mm") if homing["unit"] == "m" else (180.0 / math.pi, "deg")
    axis, at_most = homing["joint"].replace("_", " "), "" if homing["exact"] else "at most "
    return (
        f"homing {axis} ({homing['number']} of {homing['of']}): {scale * homing['gone']:.0f} of {at_most}"
        f"{scale * homing['way']:.0f} {unit}; about {homing['left_s']:.0f} s left"
    )


#: Vectors of the status, which are null while they are stale.
VECTORS = (
    "tip_measured", "tip_estimated", "tip_desired", "tip_true", "direction_measured", "direction_observed",
    "direction_desired", "direction_true", "force",
)  # fmt: skip


def status_out(
    supervisor: Supervisor,
    of: Commands,
    who: Sender,
    side_load: SideLoad | None,
    gateway_problem: str | None = None,
    own_stop: str = "",
) -> StatusOut:
    """Return the station's status.

    Args:
        supervisor: the station.
        of: dependencies that check the operator's lease.
        who: client that requests the status.
        side_load: load that acts on the shaft instead of the tip; None: there is no such load.
        gateway_problem: why the gateway has ended, empty while the gateway runs; None: the station has no gateway.
        own_stop: cause that the station reports for the newest STOP, if this client sent it; otherwise empty.
    """
    status = supervisor.status()
    stale = status.age > STALE_AFTER_S

    def vector(group: str) -> tuple[float, float, float] | None:
        known = group in status.values and group not in status.stale_groups
        return tuple(status.values[group].tolist()) if known else None

    warnings = (*status.warnings, *(() if side_load is None else (side_load.warning,)))
    names, text = supervisor.robot.joint_names, state_message(status, _reader(supervisor, of, who, own_stop))
    run = None
    if status.run is not None:
        run = RunOut(
            id=status.run.id, title=status.run.start.title, phase=status.phase.name.lower(), progress=status.progress,
            duration=status.run.start.task.duration, load=_load(status.run.start.load),
            desired_force=_desired_force(status.run.start.task.press),
            recorded=status.run.start.recorded, recording=status.recording,
            stiffness=None if (found := supervisor.runs.stiffness) is None else tuple(map(tuple, found)),
        )  # fmt: skip
    return StatusOut(
        format=FORMAT,
        state=status.state.name,
        cause=status.cause,
        details=load() if is_silent(status) else status.details,
        phase=status.phase.name.lower(),
        message=text.message,
        next=text.next,
        action=text.action,
        operator=operator_out(of.lease, who),
        stale=stale,
        age=round(status.age, 3),
        lab=supervisor.bench.title,
        simulated=supervisor.simulated,
        warnings=(*warnings, gateway_problem) if gateway_problem else warnings,
        model=supervisor.bench.model_note,
        max_force=supervisor.bench.max_force,
        run=run,
        devices=_devices(status) | _gateway(gateway_problem) | _cameras(supervisor.cameras),
        loop=LoopOut(**status.timing._asdict()),
        joints=dict(zip(names, status.values["joints"].tolist(), strict=True)) if status.values else {},
        **{name: vector(name) for name in VECTORS},
        contact=None if side_load is None else contact_out(side_load),
    )


def _reader(supervisor: Supervisor, of: Commands, who: Sender, own_stop: str) -> Reader:
    """Return the properties of the client `who`, which determine its messages."""
    holder, may = of.lease.holder(), who.role is Role.OPERATOR
    return Reader(
        resets=may and (holder is None or holder.client == who.client),
        operator=None if holder is None else holder.name,
        views_only=not may,
        own_stop=own_stop,
        simulated=supervisor.simulated,
        removed_load=supervisor.lab.removed_load,
    )


def contact_out(side_load: SideLoad) -> ContactOut:
    """Return a load on the shaft as a response."""
    x, y, z = side_load.force.tolist()
    contact = side_load.contact
    return ContactOut(
        force=(x, y, z), position=contact.arc_length if contact.located else None, intervals=contact.intervals,
        reason=contact.note,
    )  # fmt: skip


def _load(load: Load | None) -> str:
    """Return the description of a run's load; empty without a load."""
    return "" if load is None or isinstance(load, NoLoad) else describe_keys(load)


def _desired_force(press: Press | None) -> Vector | None:
    """Return the force that the tip shall exert [N]; None if the motion controls the position only."""
    if press is None:
        return None
    x, y, z = (press.force * press.direction).tolist()
    return x, y, z


def _devices(status: StationStatus) -> dict[str, DeviceOut]:
    """Return the indicator of each device. While the control loop sends no telemetry, no device is shown as good."""
    silent = status.age > STALE_AFTER_S
    return {
        device.name: DeviceOut(
            severity=max(device.severity, Severity.FAULT if silent else 0),
            condition=device.condition,
            text=f"no report for {status.age:.1f} s; {status.cause or f'the control loop is late: {load()}'}"
            if silent
            else device.text,
        )
        for device in status.devices
    }


def _cameras(cameras: Cameras) -> dict[str, DeviceOut]:
    """Return the indicator of each camera; a failed camera is only a warning."""
    found: dict[str, DeviceOut] = {}
    for host in cameras:
        problem = host.status().problem
        severity, condition = (Severity.WARN, Condition.FAULT) if problem else (0, Condition.CONNECTED)
        found[f"camera {host.name}"] = DeviceOut(severity=severity, condition=condition, text=problem)
    return found


def _gateway(problem: str | None) -> dict[str, DeviceOut]:
    """Return the indicator of the gateway; empty if the station has no gateway."""
    if problem is None:
        return {}
    severity, condition = (Severity.WARN, Condition.CLOSED) if problem else (0, Condition.CONNECTED)
    return {"gateway": DeviceOut(severity=severity, condition=condition, text=problem)}
