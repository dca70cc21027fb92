"""The live virtual lab as a bench: its endpoints, told as a station file tells a real one's."""

import math
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from station.config.strict import check
from station.devices.config import BenchFile
from station.lab.aurora.coil import MOUNT
from station.lab.aurora.simulated import TARGET_SERIAL
from station.lab.config import LabConfig

#: What a simulated device's word may take [s]. Real ones have processors of their own: a busy computer makes these
#: late and not lost.
LATE = 0.15


def devices_at(endpoints: Mapping[str, Any], config: LabConfig) -> BenchFile:
    """The `[devices]` of a lab that has told its endpoints."""
    tubes = {box["tube"]: _box(box) for box in endpoints["netft"]}
    tables: dict[str, dict[str, Any]] = {
        "stages": {"driver": "zaber", "port": endpoints["zaber"], "deadline": LATE},
        "tracker": {
            "driver": "aurora",
            "port": endpoints["aurora"],
            "frame_rate": config.tracker.rate,
            "latency": config.tracker.latency,
            # A turn by half about x, as MOUNT has it.
            "mount": {"position": MOUNT.position.tolist(), "rotation_vector": [math.pi, 0.0, 0.0]},
        },
        "sensors": {"driver": "netft", "tubes": tubes, "stale_after": LATE},
    }
    if config.target is not None:
        tables["tracker"]["target"] = TARGET_SERIAL
    return check(BenchFile, tables, "virtual lab")


def _box(endpoint: Mapping[str, str]) -> dict[str, Any]:
    page, rdt = urlsplit(endpoint["page"]), urlsplit(endpoint["rdt"])
    return {"host": rdt.hostname, "rdt_port": rdt.port, "http_port": page.port}
