"""The built-in drivers: checks the devices' tables of the station file, and returns functions that open the devices."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from core.errors import CtrError
from station.config.robots import JointFile, RobotFile
from station.config.strict import ConfigError, check
from station.devices.ati.calibration import GaugeCalibration, read_calibration
from station.devices.ati.netft import BoxAddress, NetftSettings, connect
from station.devices.ati.nidaq import CardSensors, NiCard, Wiring, device_of
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.aurora.protocol import POWER_UP_BAUD
from station.devices.aurora.tracker import AuroraTracker, TrackerMounting
from station.devices.config import AuroraFile, CardFile, NetftFile, NidaqFile, StageFile, ZaberFile, in_order
from station.devices.interfaces import BaseSensors
from station.devices.links.link import SerialLink, reopen
from station.devices.mounting import mounted
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.protocol import BAUD
from station.devices.zaber.setup import PortSetup, StageSetup
from station.devices.zaber.stages import ZaberStages


def zaber(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], ZaberStages]:
    """Return the opener of Zaber T-series stages; raises ConfigError."""
    key = "devices.stages"
    file = check(ZaberFile, options, key)
    if file.joints:
        stages = in_order(file.joints, [joint.name for joint in robot.joints], f"{key}.joints")
    else:
        stages = [StageFile(device=number) for number, _ in enumerate(robot.joints, 1)]
    lines: dict[str, list[int]] = {}
    for i, (joint, stage) in enumerate(zip(robot.joints, stages, strict=True)):
        port = stage.port or file.port
        if port is None:
            raise ConfigError(f"{key}.port is missing: {joint.name} has no port, and the chain has none")
        others = lines.setdefault(port, [])
        twin = next((k for k in others if stages[k].device == stage.device), None)
        if twin is not None:
            raise ConfigError(
                f"{key}.joints.{joint.name}.device = {stage.device}: {robot.joints[twin].name} has the same number on "
                f"{port}; give each unit of a chain a different number"
            )
        others.append(i)
    setups = [_setup(joint, stage, f"{key}.joints") for joint, stage in zip(robot.joints, stages, strict=True)]

    def opener() -> ZaberStages:
        with contextlib.ExitStack() as opened:
            ports: list[PortSetup] = []
            for url, indices in lines.items():
                link = SerialLink(url, BAUD)
                opened.callback(link.close)
                ports.append(PortSetup(link, tuple(indices)))
            stages = ZaberStages(setups, ports, LineSettings(deadline=file.deadline), _reopened)
            opened.pop_all()
            return stages

    return opener


def _reopened(ports: Sequence[PortSetup]) -> list[PortSetup]:
    return [PortSetup(reopen(port.link), port.stages) for port in ports]


def _setup(joint: JointFile, stage: StageFile, key: str) -> StageSetup:
    try:
        setup = StageSetup.of(joint, stage.device, stage.home_at, stage.backwards)
        speed = setup.home_speed if stage.home_speed is None else stage.home_speed
        return replace(setup, home_speed=speed, device_id=stage.device_id, serial=stage.serial)
    except CtrError as error:
        raise ConfigError(f"{key}.{error}") from None


def aurora(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], AuroraTracker]:  # noqa: ARG001
    """Return the opener of an NDI Aurora; raises ConfigError."""
    key = "devices.tracker"
    file = check(AuroraFile, options, key)
    try:
        settings = AuroraSettings(
            tool_serial=file.tool,
            target_serial=file.target,
            baud=file.baud,
            frame_rate=file.frame_rate,
            latency=file.latency,
            always_tx=file.always_tx,
            coil_to_tip=1e3 * file.coil_to_tip,
            fault_bits=file.fault_bits,
        )
    except CtrError as error:
        wrong = f"target = '{file.target}'" if file.target and file.target == file.tool else f"baud = {file.baud}"
        raise ConfigError(f"{key}.{wrong}: {error}") from None
    registration = TrackerMounting(file.mount.rotation, np.array(file.mount.position))
    return lambda: AuroraTracker(SerialLink(file.port, POWER_UP_BAUD), settings, registration, reopen)


def netft(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], BaseSensors]:
    """Return the opener of ATI Net F/T boxes; raises ConfigError."""
    file = check(NetftFile, options, "devices.sensors")
    boxes = in_order(file.tubes, [tube.name for tube in robot.tubes], "devices.sensors.tubes")
    settings = NetftSettings(stale_after=file.stale_after, latency=file.latency, ranges=file.ranges)
    addresses = [BoxAddress(box.host, box.rdt_port, box.http_port, box.serial) for box in boxes]
    return lambda: mounted(connect(addresses, settings), [box.mount for box in boxes])


def nidaq(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], BaseSensors]:
    """Return the opener of ATI sensors on NI cards; raises ConfigError."""
    key = "devices.sensors"
    file = check(NidaqFile, options, key)
    sensors = in_order(file.tubes, [tube.name for tube in robot.tubes], f"{key}.tubes")
    cards: dict[str, list[tuple[str, float]]] = {}
    gauges: list[tuple[str, int, GaugeCalibration]] = []
    for tube, sensor in zip(robot.tubes, sensors, strict=True):
        calibration = _calibration(sensor, f"{key}.tubes.{tube.name}")
        inputs = cards.setdefault(device_of(sensor.channels), [])
        gauges.append((device_of(sensor.channels), 6 * len(inputs), calibration))
        inputs.append((sensor.channels, calibration.volts))
    wirings = [Wiring(list(cards).index(card), first, calibration) for card, first, calibration in gauges]

    def cards_opened() -> list[NiCard]:
        with contextlib.ExitStack() as opened:
            found: list[NiCard] = []
            for inputs in cards.values():
                found.append(NiCard(inputs, file.rate))
                opened.callback(found[-1].close)
            opened.pop_all()
            return found

    return lambda: mounted(CardSensors(cards_opened, wirings, file.stale_after), [sensor.mount for sensor in sensors])


def _calibration(sensor: CardFile, key: str) -> GaugeCalibration:
    try:
        calibration = read_calibration(Path(sensor.calibration))
    except CtrError as error:
        raise ConfigError(f"{key}.calibration: {error}") from None
    if sensor.serial is not None and calibration.serial != sensor.serial:
        raise ConfigError(
            f"{key}.serial = '{sensor.serial}': {sensor.calibration} is for '{calibration.serial}'; exchanged files?"
        )
    return calibration
