"""The true lenses and poses of a virtual lab's cameras, as a perfect calibration would find them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from core.calibration.rigid_transform import kabsch, vector_from_rotation
from station.config.robots import load_robot
from station.devices.cameras import CalibratedView, LensFile
from station.devices.config import Mount
from station.devices.projection import CameraView, true_view_of
from station.devices.stereo.triangulation import triangulate
from station.lab.config import load_lab


def true_views(lab: str) -> dict[str, CalibratedView]:
    """Return lens and pose of each camera of a lab with its simulated errors."""
    found: dict[str, CalibratedView] = {}
    for name, camera in load_lab(lab, load_robot("paper")).cameras.items():
        view = true_view_of(camera)
        assert view is not None
        (fx, _, cx), (_, fy, cy), _ = view.matrix.tolist()
        position, turn = view.position.tolist(), vector_from_rotation(view.rotation.T).tolist()
        found[name] = CalibratedView(
            lens=LensFile(focal=(fx, fy), centre=(cx, cy)), pose=Mount(position=(*position,), rotation_vector=(*turn,))
        )
    return found


def write_true_views(lab: str, folder: Path) -> Path:
    """Write `cameras.toml` with the true views to a folder, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ['robot = "paper"', 'made = "true views"', "[board]", "square = 0.02"]
    cameras = load_lab(lab, load_robot("paper")).cameras
    for name, view in true_views(lab).items():
        camera = cameras[name]
        lines += [
            f"[cameras.{name}]", f'device = "{camera.device}"', f"width = {camera.width}", f"height = {camera.height}",
            f"[cameras.{name}.lens]", f"focal = {list(view.lens.focal)}", f"centre = {list(view.lens.centre)}",
            f"[cameras.{name}.pose]", f"position = {list(view.pose.position)}",
            f"rotation_vector = {list(view.pose.rotation_vector)}",
        ]  # fmt: skip
    (folder / "cameras.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def workspace_error(lab: str, found: Mapping[str, CalibratedView]) -> float:
    """Return the RMS error [m] of points of the workspace that calibrated cameras measure, after a rigid motion."""
    points = np.random.default_rng(1).uniform((-0.08, -0.08, 0.17), (0.08, 0.08, 0.28), (100, 3))
    true = [CameraView.of(view.lens, view.pose) for view in true_views(lab).values()]
    views = [CameraView.of(found[name].lens, found[name].pose) for name in true_views(lab)]
    measured = [triangulate(views, np.vstack([view.project(point[None]) for view in true])) for point in points]
    positions = np.array([one.position for one in measured if one is not None])
    assert len(positions) == len(points)
    return float(np.sqrt(((kabsch(positions, points).apply(positions) - points) ** 2).sum(axis=1).mean()))
