"""The station at one look, for the page and for scripts."""

from station.client import FORMAT
from station.devices.interfaces import Severity
from station.service.station_service import StationService
from station.service.status import STALE, Status
from web.access.identity import Who
from web.api.commands import Commands, operator_out
from web.api.messages import words
from web.api.schemas import DeviceOut, LoopOut, RunOut, StatusOut, TouchOut
from web.scene.contact import SideLoad


def status_out(service: StationService, of: Commands, who: Who, side_load: SideLoad | None) -> StatusOut:
    """The station's status; `who` asks, `side_load` is a load that does not act at the tip."""
    supervisor = service.supervisor
    status = supervisor.status()
    stale = status.age > STALE

    def vector(group: str) -> tuple[float, float, float] | None:
        known = group in status.values and group not in status.standing
        return tuple(status.values[group].tolist()) if known else None

    names, said = supervisor.robot.joint_names, words(status)
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
        says=said.what,
        next=said.next,
        act=said.act,
        operator=operator_out(of.lease, who),
        stale=stale,
        age=round(status.age, 3),
        lab=supervisor.bench.title,
        warnings=(*status.warnings, *(() if side_load is None else (side_load.warning,))),
        run=run,
        devices=_devices(status),
        loop=LoopOut(**status.timing._asdict()),
        joints=dict(zip(names, status.values["joints"].tolist(), strict=True)) if status.values else {},
        tip_measured=vector("tip_measured"),
        tip_estimated=vector("tip_estimated"),
        tip_desired=vector("tip_desired"),
        tip_true=vector("tip_true"),
        force=vector("force"),
        touch=None if side_load is None else touch_out(side_load),
    )


def touch_out(side_load: SideLoad) -> TouchOut:
    """A load beside the tip for a reader."""
    x, y, z = side_load.force.tolist()
    contact = side_load.contact
    return TouchOut(
        force=(x, y, z), place=contact.place if contact.located else None, intervals=contact.intervals,
        reason=contact.note,
    )  # fmt: skip


def _devices(status: Status) -> dict[str, DeviceOut]:
    """Lights of the devices; what was reported before the loop fell silent is not called good."""
    silent = status.age > STALE
    return {
        device.name: DeviceOut(
            severity=max(device.severity, Severity.FAULT if silent else 0),
            condition=device.condition,
            text=f"no word from it for {status.age:.1f} s; {status.cause or 'is the control process alive?'}"
            if silent
            else device.text,
        )
        for device in status.devices
    }
