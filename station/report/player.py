"""Player of a run as one HTML file: it shows tubes, tips, force and numbers in any browser, without a network.

The loaded model computes the shape of the tubes from the recorded joint positions and the filtered force, with 25
frames a second. Positions are stored as integers with a scale factor, which keeps the file small. The page interpolates
between frames.
"""

import base64
import importlib.util
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config import palette
from station.config.controllers import ControllerFile
from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.cameras import MODULES
from station.devices.projection import view_of
from station.recording.run_folder import video_files, write_atomically
from station.recording.run_outcome import RecordingError
from station.report.run import NoRun, RecordedCase, RecordedRun, ReportError, read_run

REPLAY_FILE = "replay.html"
STATIC = Path(__file__).parent / "static"
#: Frame rate of the player, and largest number of frames in a file. A longer run has a lower frame rate.
FRAME_RATE_HZ, MAX_FRAMES = 25.0, 15_000
#: Number of points that form the centre line of the tubes, equally spaced from the plate to the tip.
CENTRE_LINE_POINTS = 32
#: Largest 16-bit integer that codes a position, and the integer that codes an unknown value.
MAX_CODE, UNKNOWN_CODE = 32_767, -32_768
#: Largest size of all videos in a file [bytes]; a minute of 640 x 480 pixels has 10 MB at most.
MAX_VIDEO_BYTES = 40_000_000
TIP_CHANNELS = ("tip_desired", "tip_measured", "tip_estimated", "tip_true")


def write_player(folder: Path, out: Path | None = None, report: Callable[[float], None] = lambda _: None) -> Path:
    """Write the player of the run in `folder` and return its path.

    Args:
        folder: folder of the run.
        out: path of the file; None: replay.html in the run's folder.
        report: receives the fraction done.

    Raises:
        NoRun: the folder has no run, nothing was recorded, or the recording has no robot.
        ConfigError, RecordingError: a file of the run cannot be read.
        ReportError: the file cannot be written.
    """
    run = read_run(folder)
    if not run.cases:
        raise NoRun(f"{folder}: the run has no recorded rows to play")
    cases = []
    for number, case in enumerate(run.cases):
        cases.append(_case_data(case, lambda done, number=number: report((number + done) / len(run.cases))))
    try:
        return write_atomically(_page(run, cases), out or folder / REPLAY_FILE)
    except OSError as error:
        raise ReportError(f"{out or folder}: cannot write the player: {error.strerror}") from None


def videos(run: RecordedRun) -> list[dict[str, Any]]:
    """Return the videos of a run for the player's page, as MP4 with lens and pose; none without the extra `camera`.

    Videos beyond `MAX_VIDEO_BYTES` are left out, and so are damaged ones; the page then has a sentence about them.
    """
    if len(run.cases) != 1 or any(importlib.util.find_spec(module) is None for module in MODULES):
        return []
    found: list[dict[str, Any]] = []
    left = MAX_VIDEO_BYTES
    for path in video_files(run.folder):
        from station.camera.video import camera_of, read_frames, write_mp4  # OpenCV and PyAV are an extra

        try:
            name, camera = camera_of(path)
            first = next(read_frames(path), None)
            if first is None:
                continue
            with TemporaryDirectory() as folder:
                write_mp4(path, target := Path(folder, "video.mp4"))
                content = target.read_bytes()
        except RecordingError as error:
            found.append({"name": path.stem, "problem": f"the video is damaged: {error}"})
            continue
        left -= len(content)
        if left < 0:
            found.append({"name": name, "problem": f"{len(content) / 1e6:.0f} MB of video are too large for this page"})
            continue
        view = view_of(camera)
        found.append({
            "name": name, "problem": "", "simulated": camera.simulated, "rate": camera.rate,
            "width": camera.width, "height": camera.height, "start": 1e-9 * (first.time - run.cases[0].start),
            "view": None if view is None else {part: value.tolist() for part, value in view._asdict().items()},
            "mp4": base64.b64encode(content).decode("ascii"),
        })  # fmt: skip
    return found


def _page(run: RecordedRun, cases: list[dict[str, Any]]) -> str:
    title = str(run.table.get("title") or run.summary.get("title") or run.experiment)
    parts = {
        "TITLE": escape(title),
        "RUN": escape(run.folder.name),
        "STYLE": (STATIC / "player.css").read_text(encoding="utf-8"),
        "DATA": script_data({"simulated": run.simulated, "cases": cases, "videos": videos(run), **_colours()}),
        "SCENE": (STATIC / "scene.js").read_text(encoding="utf-8"),
        "PLAYER": (STATIC / "player.js").read_text(encoding="utf-8"),
    }
    page = (STATIC / "player.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], page)


def _colours() -> dict[str, Any]:
    """Return the colours of tubes, tips in the order of `TIP_CHANNELS`, and force, with components from 0 to 1."""
    tips = (palette.DESIRED, palette.MEASURED, palette.ESTIMATED, palette.TRUE)
    parts = [[part / 255 for part in colour] for colour in (*palette.TUBES, *tips, palette.FORCE)]
    count = len(palette.TUBES)
    return {"tube_colours": parts[:count], "tip_colours": parts[count:-1], "force_colour": parts[-1]}


def script_data(value: Any) -> str:
    """Return JSON for a script element, escaped so that no text ends the element or starts a comment."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def _case_data(case: RecordedCase, report: Callable[[float], None]) -> dict[str, Any]:
    """Return the data of a case for the player's page."""
    robot = _robot(case)
    time = case.time
    step = max(1.0 / FRAME_RATE_HZ, float(time[-1] - time[0]) / MAX_FRAMES)
    frame_times = np.arange(time[0], time[-1] + 1e-9, step)
    rows = np.searchsorted(time, frame_times - 1e-9)
    shapes = _shapes(robot, case, rows, report)
    positions = np.concatenate((shapes, *(_tip(case, group)[rows] for group in TIP_CHANNELS)), axis=1)
    known = np.isfinite(positions)
    scale = float(np.abs(positions[known]).max()) / MAX_CODE
    numbers = np.where(known, np.round(np.where(known, positions, 0.0) / scale), UNKNOWN_CODE).astype("<i2")
    others = np.concatenate((time[rows, None], case.of("force_filtered")[rows], case.of("joints")[rows]), axis=1)
    units = [channel.unit for channel in case.channels if channel.name.startswith("joints.")]
    return {
        "name": case.name,
        "frames": len(rows),
        "points": CENTRE_LINE_POINTS,
        "scale": scale,
        "tubes": [
            {"name": tube.name, "radius": tube.outer_diameter / 2.0, "length": tube.length} for tube in robot.tubes
        ],
        "plate": {"position": list(robot.base.position), "rotation": robot.base.rotation.tolist()},
        "joints": [list(pair) for pair in zip(case.names("joints"), units, strict=True)],
        "truth": case.truth_known,
        "desired": not case.sweeps,
        "packed_positions": _packed(numbers),
        "packed_others": _packed(others.astype("<f4")),
    }


def _robot(case: RecordedCase) -> Robot:
    described = case.metadata.get("robot")
    if not isinstance(described, Mapping):
        raise NoRun(f"case '{case.name}': the recording has no description of its robot")
    return check(RobotFile, described, f"case '{case.name}', robot").robot()


def _shapes(robot: Robot, case: RecordedCase, rows: NDArray[np.intp], report: Callable[[float], None]) -> Array:
    """Return the shape of the robot in each frame, as rows of a matrix (frames, 1 + q + 3 CENTRE_LINE_POINTS) [m].

    A row has the length of the centre line, the proximal ends of the q tubes, and the points of the centre line. It is
    NaN where the model has no solution.
    """
    statics = model_of(case)
    shapes = np.full((len(rows), 1 + len(robot.tubes) + 3 * CENTRE_LINE_POINTS), math.nan)
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
            report(frame / len(rows))
    return shapes


def model_of(case: RecordedCase) -> Statics:
    """Return the model with which the run was controlled; raises NoRun and ConfigError."""
    return _controller(case).model(_robot(case))


def _line(statics: Statics, solution: Solution) -> Iterator[Array]:
    sections = statics.shape(solution)
    arc, points = sections[:, 0], sections[:, 10:13]
    along = np.linspace(0.0, arc[-1], CENTRE_LINE_POINTS)
    yield arc[-1:]
    yield statics.robot.tube_poses(solution.joints)[1]
    yield np.stack([np.interp(along, arc, column) for column in points.T], axis=1).ravel()


def _controller(case: RecordedCase) -> ControllerFile:
    """Return the controller settings of a recording that determine the model."""
    settings = case.metadata.get("settings", {}).get("controller", {})
    return ControllerFile(integrator=settings.get("integrator"), sublink=settings.get("sublink"))


def _tip(case: RecordedCase, group: str) -> Array:
    """Return the positions of a tip (measured, true, ...) over time (ticks, 3) [m], NaN where they are unknown."""
    if (group == "tip_true" and not case.truth_known) or (group == "tip_desired" and case.sweeps):
        return np.full((len(case.rows), 3), math.nan)
    return case.of(group)


def _packed(numbers: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers).tobytes()).decode("ascii")
