"""A run as one HTML file that plays it: tubes, tips, force and numbers, in any browser, without a network.

The tubes are the loaded model at the recorded joints and the filtered force. Places are kept as whole
numbers of a scale that the page is told, 25 frames a second; the page interpolates between them.
"""

import base64
import json
import math
from collections.abc import Callable, Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import PAPER_SUBLINK, Statics
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import check
from station.report.run import Case, NoRun, Run, read_run
from station.report.written import ReportError, written

NAME = "replay.html"
STATIC = Path(__file__).parent / "static"
#: Frames a second, and how many at most: a longer run is shown with fewer a second.
RATE, MOST_FRAMES = 25.0, 15_000
#: Points of the centre line, evenly along it from the plate to the tip.
POINTS = 32
#: Whole numbers reach to here; the one below stands for "not known".
REACH, UNKNOWN = 32_767, -32_768
TIPS = ("tip_desired", "tip_measured", "tip_estimated", "tip_true")


def write_player(folder: Path, out: Path | None = None, told: Callable[[float], None] = lambda _: None) -> Path:
    """Make the player of the run in `folder`.

    Args:
        folder: of the run.
        out: the file; None: replay.html in the run's folder.
        told: the fraction done.

    Raises:
        NoRun: no run there, nothing recorded, or the recording does not say which robot it was.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the file cannot be written.
    """
    run = read_run(folder)
    if not run.cases:
        raise NoRun(f"{folder}: nothing was recorded that could be played")
    cases = []
    for number, case in enumerate(run.cases):
        cases.append(_played(case, lambda done, number=number: told((number + done) / len(run.cases))))
    try:
        return written(_page(run, cases), out or folder / NAME)
    except OSError as error:
        raise ReportError(f"{out or folder}: cannot write the player there: {error.strerror}") from None


def _page(run: Run, cases: list[dict[str, Any]]) -> str:
    title = str(run.table.get("title") or run.summary.get("title") or run.experiment)
    parts = {
        "TITLE": escape(title),
        "RUN": escape(run.folder.name),
        "STYLE": (STATIC / "player.css").read_text(encoding="utf-8"),
        "DATA": script_data({"simulated": run.simulated, "cases": cases}),
        "SCENE": (STATIC / "scene.js").read_text(encoding="utf-8"),
        "PLAYER": (STATIC / "player.js").read_text(encoding="utf-8"),
    }
    page = (STATIC / "player.html").read_text(encoding="utf-8")
    before, *pieces = page.split("{{")
    for piece in pieces:
        name, after = piece.split("}}", 1)
        before += parts[name] + after
    return before


def script_data(value: Any) -> str:
    """JSON for a script element: no text in it ends the element, or begins a comment or another script."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def _played(case: Case, told: Callable[[float], None]) -> dict[str, Any]:
    """What the page needs of a case."""
    robot = _robot(case)
    time = case.time
    step = max(1.0 / RATE, float(time[-1] - time[0]) / MOST_FRAMES)
    wanted = np.arange(time[0], time[-1] + 1e-9, step)
    rows = np.searchsorted(time, wanted - 1e-9)
    shapes = _shapes(robot, case, rows, told)
    places = np.concatenate((shapes, *(_tip(case, group)[rows] for group in TIPS)), axis=1)
    known = np.isfinite(places)
    scale = float(np.abs(places[known]).max()) / REACH
    numbers = np.where(known, np.round(np.where(known, places, 0.0) / scale), UNKNOWN).astype("<i2")
    others = np.concatenate((time[rows, None], case.of("force_filtered")[rows], case.of("joints")[rows]), axis=1)
    units = [channel.unit for channel in case.channels if channel.name.startswith("joints.")]
    return {
        "name": case.name,
        "frames": len(rows),
        "points": POINTS,
        "scale": scale,
        "tubes": [
            {"name": tube.name, "radius": tube.outer_diameter / 2.0, "length": tube.length} for tube in robot.tubes
        ],
        "plate": {"position": list(robot.base.position), "rotation": robot.base.rotation.tolist()},
        "joints": [list(pair) for pair in zip(case.names("joints"), units, strict=True)],
        "truth": case.truth_known,
        "desired": not case.sweeps,
        "packed_places": _packed(numbers),
        "packed_others": _packed(others.astype("<f4")),
    }


def _robot(case: Case) -> Robot:
    described = case.metadata.get("robot")
    if not isinstance(described, Mapping):
        raise NoRun(f"case '{case.name}': the recording does not say which robot it was")
    return check(RobotFile, described, f"case '{case.name}', robot").robot()


def _shapes(robot: Robot, case: Case, rows: NDArray[np.intp], told: Callable[[float], None]) -> Array:
    """Length of the centre line, proximal end of each tube, points: (frames, 1 + q + 3 POINTS) [m].

    NaN where the model finds no shape.
    """
    statics = Statics(robot, _sublink(case))
    shapes = np.full((len(rows), 1 + len(robot.tubes) + 3 * POINTS), math.nan)
    joints, force = case.of("joints"), case.of("force_filtered")
    near: Solution | None = None
    for frame, row in enumerate(rows.tolist()):
        try:
            near = statics.solve(joints[row], np.append(force[row], np.zeros(3)), near)
        except CtrError:
            near = None
            continue
        shapes[frame] = np.concatenate(list(_line(statics, near)))
        if frame % 250 == 0:
            told(frame / len(rows))
    return shapes


def _line(statics: Statics, solution: Solution) -> Iterator[Array]:
    sections = statics.shape(solution)
    arc, places = sections[:, 0], sections[:, 10:13]
    along = np.linspace(0.0, arc[-1], POINTS)
    yield arc[-1:]
    yield statics.robot.tube_poses(solution.joints)[1]
    yield np.stack([np.interp(along, arc, column) for column in places.T], axis=1).ravel()


def _sublink(case: Case) -> float:
    settings = case.metadata.get("settings", {})
    return float(settings.get("controller", {}).get("sublink", PAPER_SUBLINK))


def _tip(case: Case, group: str) -> Array:
    """(ticks, 3) [m], NaN where there is none."""
    if (group == "tip_true" and not case.truth_known) or (group == "tip_desired" and case.sweeps):
        return np.full((len(case.rows), 3), math.nan)
    return case.of(group)


def _packed(numbers: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers).tobytes()).decode("ascii")
