"""The driver of Zaber T-series stages: one chain, or a separate port for each stage."""

from collections.abc import Sequence

from station.config.controllers import StagesLatency
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.interfaces import Clock
from station.devices.kernel.axis import STAGES_KEY, joint_setups
from station.devices.kernel.driver import on_ports
from station.devices.kernel.line import LEAD_S
from station.devices.kernel.stages import LineStages, Port
from station.devices.zaber.backlog import MIN_BACKLOG_S
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.emergency_stop import stop_stages
from station.devices.zaber.protocol import BAUD, MESSAGE_TIME_S, Reply, Request
from station.devices.zaber.sequences import ZaberProtocol
from station.devices.zaber.setup import StageFile, StageSetup, ZaberFile


def zaber_stages(
    setups: Sequence[StageSetup], ports: Sequence[Port], settings: LineSettings | None = None
) -> LineStages[Request, Reply]:
    """Return the driver of Zaber units on their ports; raises CtrError if units and ports do not match."""
    return LineStages(ZaberProtocol(setups, settings), ports, Reply)


def _setups(file: ZaberFile, robot: RobotFile) -> list[StageSetup]:
    address = ("device", lambda stage: (stage.port or file.port, stage.device))
    return joint_setups(robot, file.joints, lambda number: StageFile(device=number), StageSetup.of_file, address)


def line_latency(stages: int) -> StagesLatency:
    """Return the latency of a line of T-series stages; the interval is rounded to 0.1 ms, the delay to 1 ms.

    A message takes 6.25 ms. The interval is the time for the velocities of all stages and one position query: 25 ms for
    three stages, 44 ms for six. The delay is 12 ms: a message, up to 2 ms by which a velocity is passed to the port
    before the line is free, and a backlog of up to 4 ms, which a simulated line does not have.

    A single stage gets two or three velocities per query, because a query waits for the reply to the last query. Its
    interval is 8.3 to 9.4 ms, and 10 ms with the pauses of a real line. Its delay is the 6 ms of a message.
    """
    if stages == 1:
        return StagesLatency(0.010, round(MESSAGE_TIME_S, 3))
    delay = MESSAGE_TIME_S + LEAD_S + MIN_BACKLOG_S
    return StagesLatency(round((stages + 1) * MESSAGE_TIME_S, 4), round(delay, 3))


def _lines(setups: Sequence[StageSetup], file: ZaberFile) -> dict[str, list[int]]:
    """Return the indices of the joints on each port; raises ConfigError if a joint has no port."""
    lines: dict[str, list[int]] = {}
    for i, setup in enumerate(setups):
        name = setup.joint.name
        port = (file.joints[name].port if file.joints else None) or file.port
        if port is None:
            raise ConfigError(f"{STAGES_KEY}.port is missing: {name} has no port; set one for it or for the chain")
        lines.setdefault(port, []).append(i)
    return lines


def _stop(setups: Sequence[StageSetup], file: ZaberFile, clock: Clock) -> str:
    lines = _lines(setups, file)
    return stop_stages({port: {setups[i].device for i in indices} for port, indices in lines.items()}, clock)


ZABER = on_ports(
    ZaberFile,
    _setups,
    lambda _: BAUD,
    lambda setups, ports, file: zaber_stages(setups, ports, LineSettings(deadline=file.deadline)),
    lambda setups, file: line_latency(max(map(len, _lines(setups, file).values()))),
    _stop,
    _lines,
)
