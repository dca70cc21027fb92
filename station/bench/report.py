"""What this machine achieves, in one file with machine and date.

    ctr-station bench report --out station/bench/MEASURED.md

The READMEs tell no times of their own: they point there.
"""

import os
import platform
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from station.bench.accuracy import cost
from station.bench.bench import flat, headless, model
from station.bench.cold import cold
from station.bench.loop import loop
from station.bench.recorder import recorder
from station.bench.setpoints import setpoints
from station.bench.tick import tick
from station.bench.wire import wire
from station.experiments.side_by_side import processors

#: Seconds of the ones that take as long as they are told.
LOOP, RECORDER, SETPOINTS = 60.0, 20.0, 60.0
#: By name: what it is, and how it is measured.
MEASURES: Mapping[str, tuple[str, Callable[[], dict[str, Any]]]] = {
    "model": ("The loaded model with J and C, warm, two tubes and three joints", model),
    "cost": ("How a warm solve grows with tubes and sub-links", cost),
    "tick": ("One tick of the controller in the loop", tick),
    "wire": ("One tick of the virtual lab at wire level, part by part", wire),
    "headless": ("A case of `fig10` in virtual time, everything on the wire", headless),
    "cold": ("A fresh installation: the first `run fig7`, the next one, and what was compiled", cold),
    "recorder": ("Processor time of a live recording", lambda: recorder(RECORDER)),
    "setpoints": (
        "From a script's setpoint to the stages' line, where each axis's turn comes every 25 ms",
        lambda: setpoints(SETPOINTS, lambda _: None),
    ),
    "loop": ("The live loop at 500 Hz, and beside it a timer that does nothing", lambda: loop(LOOP, lambda _: None)),
}


def measured(begin: Callable[[str], None]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each of `MEASURES` by its name, one after the other; `begin` is told which comes now."""
    for name, (_, measure) in MEASURES.items():
        begin(name)
        yield name, measure()


def text(machine: str, found: Mapping[str, Mapping[str, Any]]) -> str:
    """The file, in Markdown; `machine` as it was before anything was measured on it."""
    lines = [
        "# Measured",
        "",
        "Written by `ctr-station bench report`; do not edit, measure again. Microseconds (`us`) are medians unless a",
        "percentile is named. The devices are simulated.",
        "",
        f"{datetime.now().astimezone():%Y-%m-%d %H:%M}; {machine}.",
    ]
    for name, result in found.items():
        lines += ["", f"## `bench {name}`", "", MEASURES[name][0] + ".", "", "| figure | value |", "|---|---|"]
        lines += [f"| {figure} | {value} |" for figure, value in flat(result)]
    return "\n".join(lines) + "\n"


def machine() -> str:
    """Processor, system and versions, and what else the machine did."""
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
