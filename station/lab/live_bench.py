"""Drivers for the live virtual lab: on its terminals, sockets and ports, as on a real bench's."""

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import urlsplit

from station.devices.aurora import POWER_UP_BAUD
from station.devices.aurora_settings import AuroraSettings
from station.devices.aurora_tracker import AuroraTracker
from station.devices.interfaces import Devices
from station.devices.links import DatagramLink, Link, SerialLink
from station.devices.netft_sensors import NetftSensors, fetch_page
from station.devices.zaber import BAUD
from station.devices.zaber_setup import Port, StageSetup
from station.devices.zaber_stages import ZaberStages
from station.lab.config import LabConfig
from station.lab.simulated_aurora_coil import MOUNT
from station.robots import RobotFile


def live_devices(endpoints: Mapping[str, Any], robot: RobotFile, config: LabConfig) -> Devices:
    """Open every endpoint that the lab has told; nothing is connected yet.

    Raises:
        LinkError, SensorError, PageError: one of them is not there.
    """
    setups = [StageSetup.of(joint, number) for number, joint in enumerate(robot.joints, 1)]
    with contextlib.ExitStack() as opened:

        def serial(url: str, baud: int) -> SerialLink:
            link = SerialLink(url, baud)
            opened.callback(link.close)
            return link

        def stage_ports(before: Sequence[Port]) -> list[Port]:
            for port in before:
                port.link.close()
            return [Port(SerialLink(endpoints["zaber"], BAUD), tuple(range(len(setups))))]

        def tracker_link(before: Link) -> SerialLink:
            before.close()
            return SerialLink(endpoints["aurora"], POWER_UP_BAUD)

        stages = ZaberStages(
            setups, [Port(serial(endpoints["zaber"], BAUD), tuple(range(len(setups))))], reopen=stage_ports
        )
        settings = AuroraSettings(frame_rate=config.tracker.rate, latency=config.tracker.latency)
        tracker = AuroraTracker(serial(endpoints["aurora"], POWER_UP_BAUD), settings, MOUNT, tracker_link)
        links: list[DatagramLink] = []
        pages = []
        for box in endpoints["netft"]:
            page, rdt = urlsplit(box["page"]), urlsplit(box["rdt"])
            pages.append(fetch_page(str(page.hostname), page.port or 80))
            links.append(DatagramLink(str(rdt.hostname), rdt.port or 0))
            opened.callback(links[-1].close)
        devices = Devices(stages, tracker, NetftSensors(links, pages))
        opened.pop_all()
        return devices
