"""The projection without OpenCV equals that of OpenCV."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from station.camera.config import CameraFile, LensFile
from station.camera.projection import CameraView, view_of
from station.devices.config import Mount

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
