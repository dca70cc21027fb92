"""Shortened real runs in their folders, and synthetic cases with known numbers."""

import json
import re
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.cli.main import main
from station.config.strict import PRESETS
from station.control.telemetry import Channels
from station.report.run import RecordedCase

SHORT = """
title = "short <b>run</b> & more"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 1.5
settling = 0.5
[trajectory]
kind = "sinusoid"
amplitude = 0.001
frequency = 0.5
[load]
kind = "constant"
magnitude = 0.1
[cases.one]
[cases.two.controller]
feedforward = true
[paper.one]
max_abs_error_mm = { x = 7.9, z = 2.0 }
"""

PALPATION = """
title = "two places"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 12.0
settling = 2.0
[trajectory]
kind = "palpate"
direction = [1.0, 0.0, 0.0]
across = [0.0, 1.0, 0.0]
columns = 2
rows = 1
spacing = 0.004
travel = 2.0
dwell = 2.0
[controller]
strategy = "dual_layer"
inner = "type_2"
feedback = "observer"
load = "wrenches"
[load]
kind = "wall"
direction = [-1.0, 0.0, 0.0]
distance = 0.002
stiffness = 200.0
"""


@pytest.fixture(scope="session")
def palpation() -> str:
    """Return the text of an experiment that palpates two places on a wall of 200 N/m."""
    return PALPATION


@pytest.fixture(scope="session")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that runs an experiment's text under a name once per session and returns its folder."""
    made: dict[str, Path] = {}

    def run(name: str, text: str) -> Path:
        if name not in made:
            place = tmp_path_factory.mktemp(name)
            (place / f"{name}.toml").write_text(text, encoding="utf-8")
            printed = StringIO()
            with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
                patch.setenv("COLUMNS", "200")
                assert main(("run", str(place / f"{name}.toml"), "--jobs", "1", "--out", str(place / "runs"))) == 0
            made[name] = next((place / "runs").iterdir())
            (place / "runs" / "printed.txt").write_text(printed.getvalue(), encoding="utf-8")
        return made[name]

    return run


@pytest.fixture(scope="session")
def short_run(run_of: Callable[..., Path]) -> Path:
    """Return the folder of a run with two cases of 1.5 s."""
    return run_of("short", SHORT)


@pytest.fixture(scope="session")
def preset_run(run_of: Callable[..., Path]) -> Callable[..., Path]:
    """Return a function that runs a shortened preset without the named cases."""

    def run(name: str, duration: float, settling: float, dropped: tuple[str, ...] = ()) -> Path:
        text = (PRESETS / "experiments" / f"{name}.toml").read_text(encoding="utf-8")
        head, *tables = re.split(r"^(?=\[)", text, flags=re.MULTILINE)
        head = re.sub(r"^duration = .*", f"duration = {duration}", head, flags=re.MULTILINE)
        head = re.sub(r"^settling = .*", f"settling = {settling}", head, flags=re.MULTILINE)
        left = [table for table in tables if re.split(r"[].]", table.removeprefix("[cases."))[0] not in dropped]
        return run_of(name, head + "".join(left))

    return run


@pytest.fixture
def synthetic_case(paper_robot) -> Callable[..., RecordedCase]:
    """Return a function that makes a case of 40 rows in 4 s; every second row has a tracker frame that is 50 ms old."""

    def make(
        name: str = "synthetic_case", settling: float = 2.0, file: dict[str, Any] | None = None, **groups: Any
    ) -> RecordedCase:
        channels = Channels(paper_robot)
        rows = np.zeros((40, len(channels)))
        times = np.arange(40) * 0.1
        given = {"time": times, "tip_new": np.arange(40) % 2 == 0, "tip_time": times - 0.05, **groups}
        for group, values in given.items():
            channels.of(rows, group)[:] = np.reshape(values, (40, -1))
        return RecordedCase(name, channels.all, rows, {"settling": settling, **(file or {})}, {}, {})

    return make


@pytest.fixture
def folder_of(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that makes a folder with only a summary."""

    def write(summary: dict[str, Any], name: str = "summary.json") -> Path:
        (tmp_path / name).write_text(json.dumps(summary), encoding="utf-8")
        return tmp_path

    return write
