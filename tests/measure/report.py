"""`python -m tests.measure report`: results of the benchmarks in one file, with the date and the computer.

    python -m tests.measure report station/benchmarks/measured.toml

The documents link to this file for the computing times.
"""

import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from station.benchmarks.headless import headless, tick
from station.benchmarks.loop import loop
from station.benchmarks.model import model
from station.benchmarks.rest import rest
from station.benchmarks.tables import flat
from station.jobs.processes import processors
from tests.measure.accuracy import cost
from tests.measure.batch import many as batch
from tests.measure.cold import cold
from tests.measure.gym import gym
from tests.measure.recorder import recorder
from tests.measure.setpoints import setpoints
from tests.measure.wire import wire

#: Durations of those benchmarks that run for a given time [s].
LOOP_SECONDS, RECORDER_SECONDS, REST_SECONDS, SETPOINTS_SECONDS = 60.0, 20.0, 20.0, 60.0
#: Description and function of each benchmark, by its name.
MEASURES: Mapping[str, tuple[str, Callable[[], dict[str, Any]]]] = {
    "model": ("The loaded model with J and C, warm, two tubes and three joints", model),
    "batch": ("The model in batches of many poses, by cores and tubes", batch),
    "gym": ("Steps of the learning environments", gym),
    "cost": ("Time of a warm solve by tubes and sub-links [us]", cost),
    "tick": ("One tick of the controller in the loop", tick),
    "wire": ("One tick of the virtual lab at protocol level, part by part", wire),
    "headless": ("A case of `fig10` in virtual time, with all protocols, and the time of a tick by folder", headless),
    "cold": ("A new installation: the first `run fig7`, the second one, and the compiled code", cold),
    "rest": (
        "Start of a station, and its processes while the robot is at rest, in percent of one processor",
        lambda: rest(REST_SECONDS, lambda _: None),
    ),
    "recorder": ("Processor time of a live recording", lambda: recorder(RECORDER_SECONDS)),
    "setpoints": (
        "Delay from a script's setpoint to the stages' line, which sends to each axis every 25 ms",
        lambda: setpoints(SETPOINTS_SECONDS, lambda _: None),
    ),
    "loop": ("The live loop at 500 Hz, and an idle timer for comparison", lambda: loop(LOOP_SECONDS, lambda _: None)),
}


def measure_all(starting: Callable[[str], None]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Run all `MEASURES` and yield name and result of each; `starting` receives each name before its benchmark."""
    for name, (_, measure) in MEASURES.items():
        starting(name)
        yield name, measure()


def measured_toml(machine: str, found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the TOML text of the report; `machine` is what `describe_machine` returned before the benchmarks."""
    lines = [
        "# Written by `python -m tests.measure report`; do not edit, measure again. Microseconds (`us`) are medians",
        "# unless a percentile is named. The devices are simulated.",
        f"computer = {json.dumps(f'{datetime.now().astimezone():%Y-%m-%d %H:%M}; {machine}')}",
    ]
    for name, result in found.items():
        lines += ["", f"# {MEASURES[name][0]}.", f"[{name}]"]
        lines += [f"{json.dumps(figure)} = {json.dumps(value)}" for figure, value in flat(result)]
    return "\n".join(lines) + "\n"


def describe_machine() -> str:
    """Return a text with date, processor, operating system, versions and load average of this computer."""
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba"))
    load = f"; load average {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return (
        f"{_processor()}, {processors()} processors; {platform.system()} {platform.release()};"
        f" Python {platform.python_version()}, {libraries}{load}"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
