"""Pictures of the cameras in a report: at the start, at the largest error and at the end of a run, with the model.

The drawing over a picture is the same as on the page: tubes by the loaded model, measured and desired tip.
"""

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from core.errors import CtrError
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.robot import Array
from station.config import palette
from station.devices.cameras import MODULES
from station.devices.projection import CameraView, view_of
from station.recording.run_folder import video_files
from station.recording.run_outcome import RecordingError
from station.report import document, style
from station.report.document import ReportFigure
from station.report.player import model_of
from station.report.run import RecordedCase, RecordedRun

#: Largest number of columns of a picture in a report; a larger picture is reduced.
MAX_COLUMNS = 640
NO_EXTRA = "Pictures of the cameras need the extra 'camera': pip install 'ctr-station[camera]'."


class Moment(NamedTuple):
    """A time of a run at which the report shows a camera picture."""

    name: str
    time: float  #: since the motion's start [s]


def moments(case: RecordedCase) -> list[Moment]:
    """Return start, largest error and end of a motion."""
    found = [Moment("start", float(case.time[0]))]
    times, distance = case.distance()
    counted = np.flatnonzero(times >= case.counted_from)
    if len(counted) and not case.sweeps:
        found.append(Moment("largest error", float(times[counted[distance[counted].argmax()]])))
    return [*found, Moment("end", float(case.time[-1]))]


def camera_pictures(run: RecordedRun, origin: str, out: Path | None) -> Iterator[str]:
    """Yield the HTML elements with the pictures of every camera; nothing for a run without videos.

    A sentence replaces a video that cannot be read; the other videos are shown.

    Raises:
        OSError: a picture cannot be written into `out`.
    """
    videos = video_files(run.folder)
    if not videos or len(run.cases) != 1:
        return
    if any(importlib.util.find_spec(module) is None for module in MODULES):
        yield document.paragraph(NO_EXTRA)
        return
    for path in videos:
        try:
            drawn = _figure(run.cases[0], path)
        except RecordingError as error:
            yield document.paragraph(f"Camera '{path.stem}' has no pictures: {error}")
        else:
            if drawn is None:
                yield document.paragraph(f"Camera '{path.stem}' has no pictures: its video has no frames.")
            else:
                yield document.picture(drawn, origin, out)


def _figure(case: RecordedCase, path: Path) -> ReportFigure | None:
    from station.camera.video import camera_of, stills  # OpenCV and PyAV are an extra

    name, camera = camera_of(path)
    view, chosen = view_of(camera), moments(case)
    found = stills(path, [case.start + round(1e9 * one.time) for one in chosen])
    if not found:
        return None
    figure, panels = style.pictures(len(found), camera.height / camera.width)
    for panel, moment, (stamp, picture) in zip(panels, chosen, found, strict=True):
        every = -(-picture.shape[1] // MAX_COLUMNS)
        at = 1e-9 * (stamp - case.start)
        panel.imshow(picture[::every, ::every, ::-1], extent=(-0.5, camera.width - 0.5, camera.height - 0.5, -0.5))
        panel.set_title(f"{moment.name}, {round(at, 2) + 0.0:.2f} s", fontsize="medium")
        if view is not None:
            _draw(panel, case, view, at)
        panel.set_xlim(-0.5, camera.width - 0.5)
        panel.set_ylim(camera.height - 0.5, -0.5)
    lines = "" if view is None else " Lines: tubes by the loaded model; orange: measured tip; green: desired tip."
    kind = "Simulated camera" if camera.simulated else "Camera"
    return ReportFigure(
        f"camera_{path.stem}", f"Camera {name}",
        f"{kind} '{name}' at the times since the motion's start.{lines}",
        f"Pictures of camera {name} at {', '.join(one.name for one in chosen)}.", figure,
    )  # fmt: skip


def _draw(panel: style.Axes, case: RecordedCase, view: CameraView, time: float) -> None:
    """Draw tubes and tips at a time since the motion's start [s] over a picture."""
    overlay = overlay_at(case, view, time)
    for number, line in reversed(list(enumerate(overlay.tubes))):
        panel.plot(line[:, 0], line[:, 1], color=palette.css(palette.tube(number)), linewidth=1.2)
    for pixel, colour in ((overlay.measured, palette.MEASURED), (overlay.desired, palette.DESIRED)):
        panel.plot(*pixel, "o", markersize=5.0, fillstyle="none", color=palette.css(colour))


class RecordedOverlay(NamedTuple):
    """Drawing over a picture, in pixels: columns and rows."""

    tubes: Sequence[Array]  #: centre line (k, 2) of each tube, innermost first
    measured: Array  #: (2,) measured tip; NaN outside of the view
    desired: Array  #: (2,) desired tip


def overlay_at(case: RecordedCase, view: CameraView, time: float) -> RecordedOverlay:
    """Return the overlay of a picture that was exposed at a time since the motion's start [s]."""
    row = int(np.abs(case.time - time).argmin())
    frames, tips = case.measured_tip()
    measured = 1e-3 * tips[int(np.abs(frames - time).argmin())] if len(frames) else np.full(3, np.nan)
    try:
        statics: Statics = model_of(case)
        joints, force = case.of("joints")[row], case.of("force_filtered")[row]
        shape = statics.shape(statics.solve(joints, pure_force(force)))
        lines = [
            view.project(shape[shape[:, 0] <= end + 1e-6, 10:13]) for end in statics.robot.tube_ends(joints).tolist()
        ]
    except CtrError:
        lines = []
    return RecordedOverlay(lines, view.project(measured[None])[0], view.project(case.desired_tip()[row][None])[0])
