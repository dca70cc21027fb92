"""The projection without OpenCV equals that of OpenCV."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.devices.cameras import CameraFile, LensFile, SimulationFile
from station.devices.config import Mount
from station.devices.projection import CameraView, true_view_of, view_of

COEFFICIENT = st.floats(-0.3, 0.3)


@given(st.tuples(COEFFICIENT, COEFFICIENT, *[st.floats(-0.01, 0.01)] * 2, COEFFICIENT), st.integers(0, 1000))
def test_projection_equals_that_of_opencv(distortion: tuple[float, ...], seed: int) -> None:
    random = np.random.default_rng(seed)
    pose = Mount(position=(0.1, -0.5, 0.2), rotation_vector=tuple(random.uniform(-0.3, 0.3, 3) - 1.2))
    view = CameraView.of(LensFile(focal=(800.0, 810.0), centre=(321.0, 239.0), distortion=distortion), pose)
    points = pose.rotation @ random.uniform((-0.1, -0.1, 0.3), (0.1, 0.1, 0.6), (20, 3)).T
    points = points.T + view.position

    turn, _ = cv2.Rodrigues(view.rotation)
    expected, _ = cv2.projectPoints(points, turn, -view.rotation @ view.position, view.matrix, view.distortion)
    assert np.abs(view.project(points) - expected[:, 0]).max() < 1e-8


def test_default_camera_sees_z_to_the_right_and_x_down() -> None:
    view = view_of(CameraFile())
    assert view is not None
    origin, along, down = view.project(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2], [0.05, 0.0, 0.1]]))

    assert np.allclose((along - origin) / np.linalg.norm(along - origin), (1.0, 0.0), atol=1e-9)
    assert np.allclose((down - origin) / np.linalg.norm(down - origin), (0.0, 1.0), atol=1e-9)


def test_point_behind_the_camera_has_no_pixel() -> None:
    view = view_of(CameraFile())
    assert view is not None
    assert np.isnan(view.project(np.array([[0.0, -1.0, 0.1]]))).all()


def test_errors_of_a_simulated_camera_move_the_picture_by_their_size() -> None:
    """A rotation about y by 1 degree moves the picture by f tan(1 deg); 1 % of focal length scales it."""
    camera = CameraFile(simulation=SimulationFile(rotation_error=(0.0, np.radians(1.0), 0.0)))
    view = view_of(camera)
    assert view is not None
    ahead = view.position + view.rotation.T @ (0.0, 0.0, 0.4)
    turned, longer = true_view_of(camera), true_view_of(CameraFile(simulation=SimulationFile(focal_error=0.01)))
    assert turned is not None
    assert longer is not None

    moved = turned.project(ahead[None])[0] - view.project(ahead[None])[0]
    assert np.allclose(moved, (-640.0 * np.tan(np.radians(1.0)), 0.0), atol=1e-9)
    side = ahead + view.rotation.T @ (0.1, 0.0, 0.0)
    assert np.allclose(longer.project(side[None])[0], view.project(side[None])[0] + (0.01 * 640.0 * 0.25, 0.0))
