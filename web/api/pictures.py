"""Small pictures of experiments: the path that the tip is asked to follow, and the load over time."""

from typing import NamedTuple

import numpy as np

from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.config import palette
from station.control.loop import Task
from station.experiments.experiment import Case
from web.scene.reference import offsets

#: Of the picture [px]; each half is a square.
SIZE = 72
MARGIN = 8.0
#: The largest load that fits, so that pictures can be compared [N].
MOST_FORCE = 0.5
#: Least width of a path's picture, so that a small step looks small [m].
LEAST_SPAN = 0.02
TIMES = 200


class _Plane(NamedTuple):
    horizontal: Array
    vertical: Array


#: As the scene shows them: z to the right, gravity (+x) down; seen along z when the path lies across.
_SIDE = _Plane(np.array((0.0, 0.0, 1.0)), np.array((1.0, 0.0, 0.0)))
_FRONT = _Plane(np.array((0.0, -1.0, 0.0)), np.array((1.0, 0.0, 0.0)))


def picture(case: Case) -> str:
    """SVG of one case: the path at the left, the load's strength over the motion at the right."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * SIZE}" height="{SIZE}" viewBox="0 0 {2 * SIZE} {SIZE}">'
        f"{_path(case)}{_load(case)}</svg>"
    )


def _path(case: Case) -> str:
    middle = SIZE / 2
    cross = (
        f'<path d="M{MARGIN} {middle}H{SIZE - MARGIN}M{middle} {MARGIN}V{SIZE - MARGIN}"'
        f' stroke="#8a97a4" stroke-width=".6" opacity=".6"/>'
    )
    points = _points(case)
    if len(points) < 2:
        return cross + f'<circle cx="{middle}" cy="{middle}" r="4" fill="{palette.css(palette.DESIRED)}"/>'
    across = np.ptp(points[:, 1]) > np.ptp(points[:, 2])
    plane = _FRONT if across else _SIDE
    flat = np.stack((points @ plane.horizontal, points @ plane.vertical), axis=1)
    centre = (flat.max(axis=0) + flat.min(axis=0)) / 2
    span = max(float(np.ptp(flat, axis=0).max()), LEAST_SPAN)
    shown = middle + (flat - centre) * ((SIZE - 2 * MARGIN) / span)
    return cross + _polyline(shown, palette.css(palette.DESIRED), 2.5)


def _points(case: Case) -> Array:
    """The path, and the places of a step, from the start tip (k, 3) [m]."""
    places = [order.position for time in np.linspace(0.0, case.file.duration, TIMES)
              if isinstance(order := case.orders.at(float(time)), Setpoint)]  # fmt: skip
    if not places or np.ptp(np.array(places), axis=0).max() < 1e-9:
        return np.empty((0, 3))
    jumps = np.linalg.norm(np.array(places[0])) > 0.0
    if jumps:
        return np.array([np.zeros(3), *places])
    return offsets(Task(case.controller, case.orders, case.file.duration))


def _load(case: Case) -> str:
    times = np.linspace(0.0, case.file.duration, TIMES)
    forces = np.array([np.linalg.norm(case.file.load.force(float(time))) for time in times])
    x = SIZE + MARGIN + (SIZE - 2 * MARGIN) * times / case.file.duration
    y = SIZE - MARGIN - (SIZE - 2 * MARGIN) * np.minimum(forces / MOST_FORCE, 1.0)
    ground = f'<path d="M{SIZE + MARGIN} {SIZE - MARGIN}H{2 * SIZE - MARGIN}" stroke="#8a97a4" stroke-width=".6"/>'
    return ground + _polyline(np.stack((x, y), axis=1), palette.css(palette.FORCE), 2.0)


def _polyline(points: Array, colour: str, width: float) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>'
