"""Pictures of the calibration board in the virtual lab, computed for each pixel with the distortion of the lens."""

from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.camera.board import COLUMNS, MODULES, ROWS, modules
from station.devices.cameras import CameraFile
from station.devices.projection import CameraView, true_view_of

#: Pixels of the flat board for each of its modules.
FLAT = 12
#: Number of simulated pictures of each camera, and distance from the cameras of a board that all of them see [m].
PICTURES, SHARED_DISTANCE_M = 60, 0.5


def picture(
    view: CameraView,
    size: tuple[int, int],
    square: float,
    rotation: Array,
    position: Array,
    random: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the picture (rows, columns, 3) of a board at a pose in the world; its squares have the side `square` [m].

    The ray of each pixel, without the lens's distortion, is intersected with the board's plane; noise: 2 grey levels.
    """
    columns, rows = size
    flat = np.kron(np.where(modules(), 30.0, 225.0), np.ones((FLAT, FLAT))).astype(np.float32)
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(pixels, view.matrix, view.distortion, None, None, None)[:, 0]
    rays = np.column_stack((straight, np.ones(len(straight)))) @ view.rotation
    normal = rotation[:, 2]
    reach = ((position - view.position) @ normal) / (rays @ normal)
    on_board = (view.position + reach[:, None] * rays - position) @ rotation[:, :2]
    at = (on_board / (square / MODULES) * FLAT - 0.5).astype(np.float32).reshape(rows, columns, 2)
    at[~((reach > 0.0) & (rays @ normal > 0.0)).reshape(rows, columns)] = -1e4  # behind the camera, or its back
    grey = cv2.remap(cv2.GaussianBlur(flat, (0, 0), 2.0), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=128.0)
    noisy = np.clip(np.asarray(grey) + random.normal(0.0, 2.0, (rows, columns)), 0, 255).astype(np.uint8)
    return np.repeat(noisy[..., None], 3, axis=2)


def board_pose(view: CameraView, random: np.random.Generator, square: float) -> tuple[Array, Array]:
    """Return rotation and position of a board in front of a camera, tilted by up to 40 deg, anywhere in its picture."""
    tilt = random.uniform(-0.7, 0.7, 3) * (1.0, 1.0, 0.5)
    local, _ = cv2.Rodrigues(tilt)
    distance = random.uniform(0.3, 0.6)
    half_width, half_height = 640.0 / view.matrix[0, 0], 360.0 / view.matrix[1, 1]
    centre = distance * np.array([random.uniform(-0.6, 0.6) * half_width, random.uniform(-0.6, 0.6) * half_height, 1.0])
    corner = centre - local @ np.array([0.5 * COLUMNS * square, 0.5 * ROWS * square, 0.0])
    return view.rotation.T @ local, view.position + view.rotation.T @ corner


def shared_pose(views: Sequence[CameraView], random: np.random.Generator, square: float) -> tuple[Array, Array]:
    """Return rotation and position of a board that all cameras see: between them, tilted by up to 15 deg."""
    ahead = np.mean([view.rotation[2] for view in views], axis=0)
    ahead /= np.linalg.norm(ahead)
    across = views[0].rotation[0] - (views[0].rotation[0] @ ahead) * ahead
    across /= np.linalg.norm(across)
    facing = np.column_stack((across, np.cross(ahead, across), ahead))
    rotation = facing @ np.asarray(cv2.Rodrigues(random.uniform(-0.26, 0.26, 3))[0], np.float64)
    middle = np.mean([view.position + SHARED_DISTANCE_M * view.rotation[2] for view in views], axis=0)
    centre = middle + random.uniform(-0.03, 0.03, 3)
    return rotation, centre - rotation @ np.array([0.5 * COLUMNS * square, 0.5 * ROWS * square, 0.0])


def board_poses(cameras: Mapping[str, CameraFile], square: float, seed: int) -> tuple[tuple[Array, Array], ...]:
    """Return `PICTURES` rotations and positions of a board in front of the simulated cameras of a station.

    The board is at a random position in the picture of each camera in turn; in every second pose, all cameras see it.
    """
    random = np.random.default_rng(seed)
    views = [view for camera in cameras.values() if (view := true_view_of(camera)) is not None]
    poses: list[tuple[Array, Array]] = []
    for number in range(PICTURES):
        turn = number % (2 * len(views))
        alone = turn % 2 == 0 or len(views) < 2
        poses.append(board_pose(views[turn // 2], random, square) if alone else shared_pose(views, random, square))
    return tuple(poses)


def simulated_pictures(
    cameras: Mapping[str, CameraFile], square: float, seed: int
) -> Iterator[tuple[str, Mapping[str, NDArray[np.uint8]]]]:
    """Yield a name and the pictures of all cameras of a virtual lab for each pose of `board_poses`."""
    random = np.random.default_rng((seed, 1))
    views = {name: view for name, camera in cameras.items() if (view := true_view_of(camera)) is not None}
    for number, pose in enumerate(board_poses(cameras, square, seed)):
        yield (
            f"{number:02}",
            {
                name: picture(view, (cameras[name].width, cameras[name].height), square, *pose, random)
                for name, view in views.items()
            },
        )
