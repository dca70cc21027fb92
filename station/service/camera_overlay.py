"""Overlay of a camera's picture: the model's tubes, and the measured and the desired tip, in pixels.

The overlay belongs to the time of the picture, not to the present: a frame arrives tens of milliseconds after its
exposure, and the robot moves meanwhile.
"""

import numpy as np

from core.errors import CtrError
from core.model.solution import pure_force
from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.strict import Strict
from station.control.ring import HEARTBEAT, RING_ROWS, Ring
from station.control.states import State
from station.control.telemetry import stale_groups
from station.devices.cameras import CameraFile
from station.devices.projection import CameraView, view_of
from station.recording.run_outcome import desired
from station.service.status import STALE_AFTER_S
from station.service.supervisor import Supervisor

#: Number of rows over which joints and force are averaged, because the force's noise would shake the drawn tubes.
MEAN_ROWS = 50
NO_CALIBRATION = (
    "the lens or the pose of this camera is not known: add `lens` and `pose` to its table in the station file"
)

Pixel = tuple[float, float]


class CameraOverlay(Strict):
    """Overlay of one picture; coordinates are column and row [pixel]."""

    width: int
    """columns of the picture"""
    height: int
    """rows of the picture"""
    reason: str
    """why there is no overlay; empty if there is one"""
    tubes: tuple[tuple[Pixel, ...], ...] = ()
    """centre line of each tube as the model computes it, innermost tube first"""
    tip_measured: Pixel | None = None
    """tip that the tracker has measured; null: not measured now, or outside of the camera's view"""
    tip_desired: Pixel | None = None
    """desired tip during a motion; null: the tip follows no path"""


def overlay(supervisor: Supervisor, camera: CameraFile, exposed: float) -> CameraOverlay:
    """Return the overlay of a picture that was exposed at the time `exposed` of the station's clock [s]."""
    view = view_of(camera)
    if view is None:
        return _none(camera, NO_CALIBRATION)
    rows = rows_at(supervisor.ring, exposed)
    status = supervisor.status()
    if len(rows) == 0 or status.age > STALE_AFTER_S:
        return _none(camera, "the station has no current telemetry")
    of, row = supervisor.channels.of, rows[len(rows) // 2]
    # A tracker's frame arrives late, so take the tip from the row whose measurement time is nearest to the exposure.
    times, measured = of(rows, "time")[:, 0], of(rows, "tip_time")[:, 0]
    tip = of(rows, "tip_measured")[int(np.argmin(np.abs(measured - times[len(rows) // 2])))]
    stale = stale_groups(supervisor.channels, row)
    goals = desired(lambda group: of(rows, group), "target_measured")
    try:
        tubes = _tubes(supervisor, view, of(rows, "joints").mean(axis=0), of(rows, "force_filtered").mean(axis=0))
    except CtrError:
        tubes = ()
    follows = status.state is State.RUNNING and "tip_desired" not in stale
    return CameraOverlay(
        width=camera.width,
        height=camera.height,
        reason="" if tubes else "the model has no shape at these joint positions",
        tubes=tubes,
        tip_measured=None if "tip_measured" in stale else _pixel(view, tip),
        tip_desired=_pixel(view, goals[len(rows) // 2]) if follows else None,
    )


def rows_at(ring: Ring, exposed: float) -> Array:
    """Return the rows (n, channels) of telemetry around the time `exposed` [s], which is that of the middle row."""
    ticks = round((float(ring.numbers[HEARTBEAT]) - exposed) / PERIOD_S)
    back = min(max(ticks, 0), RING_ROWS - 2 * MEAN_ROWS)
    half = min(MEAN_ROWS // 2, max(back, 1))
    rows, _, _ = ring.read(max(ring.written - 1 - back - half, 0))
    return rows[: 2 * half + 1]


def _none(camera: CameraFile, reason: str) -> CameraOverlay:
    return CameraOverlay(width=camera.width, height=camera.height, reason=reason)


def _tubes(supervisor: Supervisor, view: CameraView, joints: Array, force: Array) -> tuple[tuple[Pixel, ...], ...]:
    statics, robot = supervisor.statics, supervisor.robot
    shape = statics.shape(statics.solve(joints, pure_force(force)))
    arc, pixels = shape[:, 0], view.project(shape[:, 10:13])
    lines: list[tuple[Pixel, ...]] = []
    for end in robot.tube_ends(joints).tolist():
        line = pixels[: int(np.searchsorted(arc, end + 1e-6))]
        lines.append(tuple(_rounded(one) for one in line[np.isfinite(line).all(axis=1)]))
    return tuple(lines)


def _pixel(view: CameraView, point: Array) -> Pixel | None:
    pixel = view.project(point[None])[0]
    return _rounded(pixel) if np.isfinite(pixel).all() else None


def _rounded(pixel: Array) -> Pixel:
    column, row = np.clip(pixel, -1e5, 1e5).tolist()
    return round(column, 2), round(row, 2)
