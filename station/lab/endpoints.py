"""Converts the endpoints of the live virtual lab to the `[devices]` of a station file."""

import math
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from station.config.strict import check
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.devices.config import BenchFile
from station.lab.aurora.coil import GENERATOR_POSE
from station.lab.aurora.simulated import TARGET_SERIAL
from station.lab.config import LabConfig


def devices_at(endpoints: Mapping[str, Any], config: LabConfig, clock: StationClock = REAL_TIME_CLOCK) -> BenchFile:
    """Return the `[devices]` of a lab with these endpoints; `clock` sets their timeouts."""
    tubes = {box["tube"]: _box(box) for box in endpoints["netft"]}
    tables: dict[str, dict[str, Any]] = {
        "stages": {"driver": "zaber", "port": endpoints["zaber"], "deadline": clock.patience},
        "tracker": {
            "driver": "aurora",
            "port": endpoints["aurora"],
            "frame_rate": config.tracker.rate,
            "latency": config.tracker.latency,
            # The generator is upside down, as in `GENERATOR_POSE`: half a turn about x.
            "mount": {"position": GENERATOR_POSE.position.tolist(), "rotation_vector": [math.pi, 0.0, 0.0]},
        },
        "sensors": {"driver": "netft", "tubes": tubes, "stale_after": clock.patience},
    }
    if config.target is not None:
        tables["tracker"]["target"] = TARGET_SERIAL
    return check(BenchFile, tables, "virtual lab")


def _box(endpoint: Mapping[str, str]) -> dict[str, Any]:
    page, rdt = urlsplit(endpoint["page"]), urlsplit(endpoint["rdt"])
    return {"host": rdt.hostname, "rdt_port": rdt.port, "http_port": page.port}
