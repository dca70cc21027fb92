"""The live virtual lab as a bench: its endpoints, told as a station file tells a real one's."""

import math
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from station.config.strict import check
from station.control.clock import REAL_TIME, StationClock
from station.devices.config import BenchFile
from station.lab.aurora.coil import MOUNT
from station.lab.aurora.simulated import TARGET_SERIAL
from station.lab.config import LabConfig


def devices_at(endpoints: Mapping[str, Any], config: LabConfig, clock: StationClock = REAL_TIME) -> BenchFile:
    """The `[devices]` of a lab that has told its endpoints, on a computer for which `clock` has patience."""
    tubes = {box["tube"]: _box(box) for box in endpoints["netft"]}
    tables: dict[str, dict[str, Any]] = {
        "stages": {"driver": "zaber", "port": endpoints["zaber"], "deadline": clock.patience},
        "tracker": {
            "driver": "aurora",
            "port": endpoints["aurora"],
            "frame_rate": config.tracker.rate,
            "latency": config.tracker.latency,
            # A turn by half about x, as MOUNT has it.
            "mount": {"position": MOUNT.position.tolist(), "rotation_vector": [math.pi, 0.0, 0.0]},
        },
        "sensors": {"driver": "netft", "tubes": tubes, "stale_after": clock.patience},
    }
    if config.target is not None:
        tables["tracker"]["target"] = TARGET_SERIAL
    return check(BenchFile, tables, "virtual lab")


def _box(endpoint: Mapping[str, str]) -> dict[str, Any]:
    page, rdt = urlsplit(endpoint["page"]), urlsplit(endpoint["rdt"])
    return {"host": rdt.hostname, "rdt_port": rdt.port, "http_port": page.port}
