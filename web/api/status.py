"""Status of the station, for the page and for scripts."""

from station.client import FORMAT
from station.control.realtime import load
from station.devices.interfaces import Condition, Severity
from station.service.station_service import StationService
from station.service.status import STALE_AFTER_S, StationStatus
from web.access.identity import Sender
from web.api.commands import Commands, operator_out
from web.api.messages import state_message
from web.api.schemas import ContactOut, DeviceOut, LoopOut, RunOut, StatusOut
from web.scene.contact import SideLoad


def status_out(
    service: StationService, of: Commands, who: Sender, side_load: SideLoad | None, gateway_problem: str | None = None
) -> StatusOut:
    """Return the station's status.

    Args:
        service: operations of the station.
        of: dependencies that check the operator's lease.
        who: client that requests the status.
        side_load: load that acts on the shaft instead of the tip; None: there is no such load.
        gateway_problem: why the gateway has ended, empty while the gateway runs; None: the station has no gateway.
    """
    supervisor = service.supervisor
    status = supervisor.status()
    stale = status.age > STALE_AFTER_S

    def vector(group: str) -> tuple[float, float, float] | None:
        known = group in status.values and group not in status.stale_groups
        return tuple(status.values[group].tolist()) if known else None

    warnings = (*status.warnings, *(() if side_load is None else (side_load.warning,)))
    names, text = supervisor.robot.joint_names, state_message(status)
    run = None
    if status.run is not None:
        run = RunOut(
            id=status.run.id, title=status.run.start.title, phase=status.phase.name.lower(), progress=status.progress,
            duration=status.run.start.task.duration, recorded=status.run.start.recorded, recording=status.recording,
        )  # fmt: skip
    return StatusOut(
        format=FORMAT,
        state=status.state.name,
        cause=status.cause,
        phase=status.phase.name.lower(),
        message=text.message,
        next=text.next,
        action=text.action,
        operator=operator_out(of.lease, who),
        stale=stale,
        age=round(status.age, 3),
        lab=supervisor.bench.title,
        warnings=(*warnings, gateway_problem) if gateway_problem else warnings,
        model=supervisor.bench.model_note,
        max_force=supervisor.bench.max_force,
        run=run,
        devices=_devices(status) | _gateway(gateway_problem),
        loop=LoopOut(**status.timing._asdict()),
        joints=dict(zip(names, status.values["joints"].tolist(), strict=True)) if status.values else {},
        tip_measured=vector("tip_measured"),
        tip_estimated=vector("tip_estimated"),
        tip_desired=vector("tip_desired"),
        tip_true=vector("tip_true"),
        direction_measured=vector("direction_measured"),
        direction_observed=vector("direction_observed"),
        direction_desired=vector("direction_desired"),
        direction_true=vector("direction_true"),
        force=vector("force"),
        contact=None if side_load is None else contact_out(side_load),
    )


def contact_out(side_load: SideLoad) -> ContactOut:
    """Return a load on the shaft as a response."""
    x, y, z = side_load.force.tolist()
    contact = side_load.contact
    return ContactOut(
        force=(x, y, z), position=contact.arc_length if contact.located else None, intervals=contact.intervals,
        reason=contact.note,
    )  # fmt: skip


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


def _gateway(problem: str | None) -> dict[str, DeviceOut]:
    """Return the indicator of the gateway; empty if the station has no gateway."""
    if problem is None:
        return {}
    severity, condition = (Severity.WARN, Condition.CLOSED) if problem else (0, Condition.CONNECTED)
    return {"gateway": DeviceOut(severity=severity, condition=condition, text=problem)}
