"""`python -m tests.measure wire`: time of plant, simulated devices and drivers in a tick, without the controller.

    python -m tests.measure wire

The stages move under the load of the experiment `fig10`. Python's garbage collection is off.
"""

import gc
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from core.errors import CtrError
from station.config.loads import RaisedCosineLoad
from station.config.robots import load_robot
from station.devices.interfaces import Condition
from station.lab.config import LabConfig
from station.lab.plant import Plant
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import drivers

TICK_S = 0.002
#: Number of ticks over which a time is averaged; a result is the median of these averages.
CHUNK_TICKS = 50
START_JOINTS = np.array([0.0, 0.5 * math.pi, -0.1])
LOAD = RaisedCosineLoad(peak=0.5, period=20.0)


def wire(seconds: float = 20.0) -> dict[str, Any]:
    """Return the times for a tick of each part and of all parts [us], over `seconds` of simulated time.

    `lab` is the plant with the simulated devices. `plant` is measured a second time, alone. `all` is the sum of the lab
    and the drivers.

    Raises:
        CtrError: the simulated stages did not connect.
    """
    robot, config = load_robot("paper"), LabConfig()
    lab = SimulatedBench(robot, config, 0, START_JOINTS, homed=True)
    devices = drivers(lab)
    stages, tracker, sensors = devices.stages, devices.tracker, devices.sensors
    assert tracker is not None, "the default lab has a tracker"
    assert sensors is not None, "the default lab has force sensors"
    now = 0.0

    def velocities() -> np.ndarray:
        return np.array([0.02, 0.05, 0.0031]) * math.cos(0.1 * math.pi * now)

    for device in (stages, tracker, sensors):
        device.connect(now)
    while not stages.ready:
        if now > 20.0 or stages.condition is Condition.FAULT:
            raise CtrError(f"the simulated stages did not connect: {stages.trouble(now)}")
        lab.advance(now)
        stages.poll(now)
        now += TICK_S
    lab.apply_load(LOAD, now)
    alone = Plant(robot.robot(), config.plant, np.random.default_rng(0), START_JOINTS)
    parts: dict[str, Callable[[], object]] = {
        "lab": lambda: lab.advance(now),
        "stages poll": lambda: stages.poll(now),
        "tracker poll": lambda: tracker.poll(now),
        "sensors poll": lambda: sensors.poll(now),
        "stages command": lambda: stages.command(velocities(), now),
        "plant": lambda: alone.advance(lab.positions, lab.truth.force),
    }
    taken = np.zeros((round((seconds + 1.0) / TICK_S / CHUNK_TICKS), len(parts)))
    gc.collect()
    gc.disable()
    try:
        for row in taken:
            for _ in range(CHUNK_TICKS):
                for column, part in enumerate(parts.values()):
                    start = time.perf_counter()
                    part()
                    row[column] += time.perf_counter() - start
                now += TICK_S
    finally:
        gc.enable()
    means = 1e6 / CHUNK_TICKS * taken[round(1.0 / TICK_S / CHUNK_TICKS) :]  # the first second is a warm-up
    medians = np.median(means, axis=0)
    us = dict(zip(parts, np.round(medians, 1).tolist(), strict=True))
    return {"ticks": len(means) * CHUNK_TICKS, "us": us | {"all": round(float(medians[:5].sum()), 1)}}
