"""Rendering of the virtual lab's tubes as a camera sees them: tubes, ball at the tip, load, and the sensor's noise.

Outlines are drawn with an accuracy of 1/16 pixel; the ball, which a tracker measures, is drawn pixel by pixel.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array, Robot
from station.devices.cameras import CameraFile, SimulationFile
from station.devices.projection import CameraView
from station.lab.plant import TubeShape

Picture = NDArray[np.uint8]  #: (rows, columns, 3) blue, green, red

#: Number of points of a drawn centre line.
POINTS = 80
#: Fractional bits of OpenCV's drawing coordinates.
BITS = 4
#: Length of the drawn load [m/N], width of its shaft and length of its head [m].
LOAD_M_PER_N, LOAD_WIDTH_M, LOAD_HEAD_M = 0.06, 0.0025, 0.008
#: Colours as blue, green, red.
BACK_TOP, BACK_BOTTOM = (122, 112, 104), (96, 88, 80)
METAL = ((70, 74, 78), (150, 156, 160), (214, 220, 224))
PLATE, LOAD, BALL = (58, 54, 50), (0, 159, 230), (60, 200, 40)
#: Half of the plate's edge [m].
PLATE_M = 0.022
#: Number of pixels by which a noise picture is larger than a frame; each frame uses a random part of it.
NOISE_MARGIN = 64


def centre_points(line: Array, arc: Array) -> Array:
    """Return positions (k, 3) [m] on a centre line (m, 7) at arc lengths (k,) [m], by cubic interpolation."""
    rows = line[np.append(True, np.diff(line[:, 0]) > 1e-9)]
    if len(rows) == 1:  # all tubes are flush with the plate
        return np.repeat(rows[:, 1:4], len(arc), axis=0)
    before = np.clip(np.searchsorted(rows[:, 0], arc, side="right") - 1, 0, len(rows) - 2)
    a, b = rows[before], rows[before + 1]
    step = b[:, :1] - a[:, :1]
    u = np.clip((arc[:, None] - a[:, :1]) / step, 0.0, 1.0)
    return (
        (1 + 2 * u) * (1 - u) ** 2 * a[:, 1:4]
        + u * (1 - u) ** 2 * step * a[:, 4:7]
        + u**2 * (3 - 2 * u) * b[:, 1:4]
        + u**2 * (u - 1) * step * b[:, 4:7]
    )


class Renderer:
    """Renders the frames of one simulated camera; `seed` determines the noise."""

    def __init__(self, robot: Robot, camera: CameraFile, view: CameraView, seed: int) -> None:
        simulation = camera.simulation or SimulationFile()
        self._view, self._size = view, (camera.height, camera.width)
        self._diameters = [tube.outer_diameter for tube in robot.tubes]
        self._ball = simulation.ball
        self._random = np.random.default_rng(seed)
        self._noise = None
        if simulation.noise > 0.0:
            shape = (camera.height + NOISE_MARGIN, camera.width + NOISE_MARGIN)
            noise = self._random.normal(0.0, simulation.noise, (*shape, 3))
            self._noise = np.clip(np.round(noise), -127, 127).astype(np.int8)
        self._back = self._background(robot)

    def render(self, shape: TubeShape | None) -> Picture:
        """Return the picture of a shape, or of the bench without tubes if `shape` is None."""
        picture = self._back.copy()
        if shape is not None:
            for diameter, end in reversed(list(zip(self._diameters, shape.ends.tolist(), strict=True))):
                if end > 0.0:
                    self._tube(picture, centre_points(shape.line, np.linspace(0.0, end, POINTS)), diameter)
            self._load(picture, shape)
            if self._ball > 0.0:
                self._draw_ball(picture, centre_points(shape.line, shape.ends[:1])[0])
        if self._noise is None:
            return picture
        row, column = self._random.integers(0, NOISE_MARGIN, 2)
        rows, columns = self._size
        noise = self._noise[row : row + rows, column : column + columns]
        return cv2.add(picture, noise, dtype=cv2.CV_8U)  # pyright: ignore[reportReturnType]

    def _background(self, robot: Robot) -> Picture:
        rows, columns = self._size
        part = np.linspace(0.0, 1.0, rows)[:, None]
        column = np.array(BACK_TOP) * (1.0 - part) + np.array(BACK_BOTTOM) * part
        picture = np.repeat(column[:, None, :].astype(np.uint8), columns, axis=1)
        corners = PLATE_M * np.array([[-1, -1, -0.2], [1, -1, -0.2], [1, 1, -0.2], [-1, 1, -0.2]])
        front = corners * (1, 1, 0)
        base = np.array(robot.base.position)
        outline = self._view.project(np.vstack((corners, front)) @ robot.base.rotation.T + base)
        if np.isfinite(outline).all():
            hull = cv2.convexHull(outline.astype(np.float32))
            cv2.fillPoly(picture, [_fixed(np.asarray(hull[:, 0], np.float64))], PLATE, cv2.LINE_AA, BITS)
        return picture

    def _tube(self, picture: Picture, points: Array, diameter: float) -> None:
        pixels = self._view.project(points)
        width = self._pixels(points, diameter)
        seen = np.isfinite(pixels).all(axis=1)
        if seen.sum() < 2:
            return
        pixels, width = pixels[seen], width[seen]
        along = np.gradient(pixels, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        across = np.column_stack((-along[:, 1], along[:, 0])) * width[:, None]
        for colour, part in zip(METAL, (0.5, 0.3, 0.12), strict=True):
            outline = np.vstack((pixels + part * across, (pixels - part * across)[::-1]))
            cv2.fillPoly(picture, [_fixed(outline)], colour, cv2.LINE_AA, BITS)

    def _load(self, picture: Picture, shape: TubeShape) -> None:
        size = float(np.linalg.norm(shape.force))
        if size < 1e-3:
            return
        at = float(shape.ends[0] if np.isinf(shape.contact) else min(shape.contact, shape.ends.max()))
        tip = centre_points(shape.line, np.array([at]))[0]
        end = tip + LOAD_M_PER_N * shape.force
        pixels = self._view.project(np.stack((tip, end)))
        if not np.isfinite(pixels).all():
            return
        (start, head), width = _fixed(pixels), max(1, round(float(self._pixels(tip[None], LOAD_WIDTH_M)[0])))
        share = min(1.0, LOAD_HEAD_M / (LOAD_M_PER_N * size))
        cv2.arrowedLine(picture, start.tolist(), head.tolist(), LOAD, width, cv2.LINE_AA, BITS, share)

    def _draw_ball(self, picture: Picture, centre: Array) -> None:
        """Draw a shaded ball with soft edges; its centre is exact to a hundredth of a pixel."""
        column, row = self._view.project(centre[None])[0]
        radius = 0.5 * float(self._pixels(centre[None], self._ball)[0])
        if not math.isfinite(column + row + radius):
            return
        rows, columns = self._size
        top, left = max(0, math.floor(row - radius - 1)), max(0, math.floor(column - radius - 1))
        bottom, right = min(rows, math.ceil(row + radius + 2)), min(columns, math.ceil(column + radius + 2))
        if top >= bottom or left >= right:
            return
        down, across = np.mgrid[top:bottom, left:right]
        distance = np.hypot(across - column, down - row)
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
        shade = (1.0 - 0.45 * np.clip(distance / max(radius, 1.0), 0.0, 1.0) ** 2)[..., None]
        part = picture[top:bottom, left:right]
        part[:] = np.round((1.0 - cover) * part + cover * shade * np.array(BALL)).astype(np.uint8)

    def _pixels(self, points: Array, length: float) -> Array:
        """Convert a length [m] across the line of sight at points (n, 3) to pixels (n,)."""
        return self._view.matrix[0, 0] * length / self._view.in_camera(points)[:, 2]


def _fixed(pixels: Array) -> NDArray[np.int32]:
    """Return pixels (n, 2) in OpenCV's fixed-point coordinates."""
    return np.round(pixels * 2.0**BITS).clip(-(2**24), 2**24).astype(np.int32)
