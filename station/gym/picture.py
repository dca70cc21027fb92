"""Picture of one robot for the render mode `rgb_array` of the environments."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from core.model.statics import Statics
from core.robot.robot import Array, Robot

#: Width and height of a picture [pixels].
IMAGE_PX = 480
Pixels = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


def picture(robot: Robot, joints: Array, wrench: Array, tip: Array, marks: Array) -> Pixels:
    """Return a picture (IMAGE_PX, IMAGE_PX, 3) of the loaded model's shape, the tip and the points `marks` (m, 3)."""
    model = Statics(robot)
    line = 1e3 * model.shape(model.solve(joints, wrench))[:, 10:13]
    figure = Figure((IMAGE_PX / 100, IMAGE_PX / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    axes.plot(*line.T, color="#3b6ea5", linewidth=3)
    axes.plot(*(1e3 * marks.T), color="#c2571a", marker="o" if len(marks) == 1 else None)
    axes.scatter(*(1e3 * tip), color="black", s=18)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_aspect("equal")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3].copy()
