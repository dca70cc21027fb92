"""Small pictures of experiments: the desired path of the tip, and the load over time."""

from typing import NamedTuple

import numpy as np

from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.config import palette
from station.control.loop import MotionTask
from station.experiments.experiment import Case
from web.scene.reference import path_offsets

#: Height of an experiment's picture [px]; the path and the load each fill a square.
PICTURE_PX = 72
MARGIN_PX = 8.0
#: Force at the top of the picture [N]; all pictures use the same scale, so that they can be compared.
MAX_FORCE_N = 0.5
#: Smallest width of a path's picture [m], so that a small step appears small.
MIN_SPAN_M = 0.02
SAMPLE_COUNT = 200


class _Plane(NamedTuple):
    horizontal: Array
    vertical: Array


#: Projection planes as in the scene. From the side, z points right and gravity (+x) down. The front
#: view, along z, is for a path that extends across the z axis.
_SIDE = _Plane(np.array((0.0, 0.0, 1.0)), np.array((1.0, 0.0, 0.0)))
_FRONT = _Plane(np.array((0.0, -1.0, 0.0)), np.array((1.0, 0.0, 0.0)))


def picture(case: Case) -> str:
    """Return an SVG of one case: the path at the left, the load's magnitude over time at the right."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * PICTURE_PX}" height="{PICTURE_PX}" viewBox="0 0'
        f' {2 * PICTURE_PX} {PICTURE_PX}">'
        f"{_path(case)}{_load(case)}</svg>"
    )


def _path(case: Case) -> str:
    middle = PICTURE_PX / 2
    cross = (
        f'<path d="M{MARGIN_PX} {middle}H{PICTURE_PX - MARGIN_PX}M{middle} {MARGIN_PX}V{PICTURE_PX - MARGIN_PX}"'
        f' stroke="#8a97a4" stroke-width=".6" opacity=".6"/>'
    )
    points = _points(case)
    if len(points) < 2:
        return cross + f'<circle cx="{middle}" cy="{middle}" r="4" fill="{palette.css(palette.DESIRED)}"/>'
    across = np.ptp(points[:, 1]) > np.ptp(points[:, 2])
    plane = _FRONT if across else _SIDE
    flat = np.stack((points @ plane.horizontal, points @ plane.vertical), axis=1)
    centre = (flat.max(axis=0) + flat.min(axis=0)) / 2
    span = max(float(np.ptp(flat, axis=0).max()), MIN_SPAN_M)
    shown = middle + (flat - centre) * ((PICTURE_PX - 2 * MARGIN_PX) / span)
    return cross + _polyline(shown, palette.css(palette.DESIRED), 2.5)


def _points(case: Case) -> Array:
    """Return points (k, 3) [m] of the desired path, or of the steps, relative to the tip at the start."""
    positions = [order.position for time in np.linspace(0.0, case.file.duration, SAMPLE_COUNT)
              if isinstance(order := case.orders.at(float(time)), Setpoint)]  # fmt: skip
    if not positions or np.ptp(np.array(positions), axis=0).max() < 1e-9:
        return np.empty((0, 3))
    jumps = np.linalg.norm(np.array(positions[0])) > 0.0
    if jumps:
        return np.array([np.zeros(3), *positions])
    return path_offsets(MotionTask(case.controller, case.orders, case.file.duration))


def _load(case: Case) -> str:
    times = np.linspace(0.0, case.file.duration, SAMPLE_COUNT)
    forces = np.array([np.linalg.norm(case.file.load.force(float(time))) for time in times])
    x = PICTURE_PX + MARGIN_PX + (PICTURE_PX - 2 * MARGIN_PX) * times / case.file.duration
    y = PICTURE_PX - MARGIN_PX - (PICTURE_PX - 2 * MARGIN_PX) * np.minimum(forces / MAX_FORCE_N, 1.0)
    left, right, bottom = PICTURE_PX + MARGIN_PX, 2 * PICTURE_PX - MARGIN_PX, PICTURE_PX - MARGIN_PX
    ground = f'<path d="M{left} {bottom}H{right}" stroke="#8a97a4" stroke-width=".6"/>'
    return ground + _polyline(np.stack((x, y), axis=1), palette.css(palette.FORCE), 2.0)


def _polyline(points: Array, colour: str, width: float) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>'
