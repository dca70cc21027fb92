"""Calibration of the lens of a camera, and of the pose of a second camera, from pictures of the board.

The model of the lens is OpenCV's with the coefficients k1, k2, p1 and p2 (Zhang 2000; Brown 1971). The coefficient k3
is 0, because pictures of a small board do not determine it.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from core.errors import CtrError
from core.robot.robot import Array
from station.camera.board import corner_positions
from station.config.strict import FORMAT, ConfigError, check, toml_lines
from station.devices.cameras import LensFile
from station.devices.config import Mount

#: Smallest number of corners in a usable picture, of usable pictures of a camera, and of usable pairs of pictures.
MIN_CORNERS, MIN_VIEWS, MIN_PAIRS = 8, 10, 8
#: Numbers of cells of a picture along its columns and rows, and share of these cells in which corners are needed.
COVERAGE_CELLS, MIN_COVERAGE = (8, 6), 0.5
#: Largest relative standard deviation of a focal length, and largest RMS distance of corners from the model [pixel].
MAX_FOCAL_DEVIATION, MAX_RMS_PIXELS = 0.005, 1.0
#: A picture is an outlier if its RMS distance exceeds the median of all pictures by this factor, and this size [pixel].
OUTLIER_FACTOR, OUTLIER_PIXELS = 3.0, 0.15


class CalibrationRefused(CtrError):
    """The pictures do not determine the lens or the pose; the message has instructions."""


class View(NamedTuple):
    """Corners of the board in one picture."""

    name: str
    numbers: NDArray[np.int64]  #: (k,)
    pixels: Array  #: (k, 2) column and row


class LensResult(NamedTuple):
    """Calibrated lens of a camera."""

    lens: LensFile
    rms: float  #: distance of the corners from the model [pixel]
    focal_deviation: float  #: standard deviation of the focal lengths [pixel]
    coverage: float  #: share of the cells of the picture in which a corner of the board was found
    used: int  #: number of pictures in the fit: neither outliers nor pictures with too few corners
    outliers: tuple[str, ...]  #: names of pictures that were left out


class PairResult(NamedTuple):
    """Calibrated pose of a second camera."""

    relative: Mount  #: pose of the second camera in the frame of the first
    rms: float  #: distance of the corners of both cameras from the model [pixel]
    used: int  #: number of pairs of pictures


def coverage(views: Sequence[View], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return whether each cell (rows, columns) of a picture of `size` (columns, rows) has a corner of any view."""
    cells = np.zeros(COVERAGE_CELLS[::-1], np.bool_)
    for view in views:
        at = (view.pixels / size * COVERAGE_CELLS).astype(int)
        cells[np.clip(at[:, 1], 0, COVERAGE_CELLS[1] - 1), np.clip(at[:, 0], 0, COVERAGE_CELLS[0] - 1)] = True
    return cells


def paired(first: Sequence[View], second: Sequence[View]) -> int:
    """Return the number of pairs of pictures that show enough of the same corners."""
    others = {view.name: view for view in second}
    return sum(
        view.name in others and len(np.intersect1d(view.numbers, others[view.name].numbers)) >= MIN_CORNERS
        for view in first
    )


def calibrate_lens(views: Sequence[View], size: tuple[int, int], square: float) -> LensResult:
    """Return the lens of a camera with pictures of `size` (columns, rows), from views of a board.

    Args:
        views: corners in pictures of the board in different poses.
        size: number of columns and rows of a picture.
        square: side of the board's squares [m].

    Raises:
        CalibrationRefused: there are too few pictures, or the board covers too little of them or was not tilted.
    """
    kept = [view for view in views if len(view.numbers) >= MIN_CORNERS]
    outliers: list[str] = []
    while True:
        if len(kept) < MIN_VIEWS:
            raise CalibrationRefused(
                f"{len(kept)} pictures show at least {MIN_CORNERS} corners of the board without an error; at least"
                f" {MIN_VIEWS} are needed: take more, in focus and without motion"
            )
        corners = corner_positions(square)
        rms, matrix, distortion, _, _, deviations, _, each = cv2.calibrateCameraExtended(
            [corners[view.numbers].astype(np.float32) for view in kept],
            [view.pixels.astype(np.float32) for view in kept],
            size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3,
        )  # fmt: skip
        errors = np.asarray(each, np.float64).ravel()
        worst = int(errors.argmax())
        if errors[worst] <= max(OUTLIER_FACTOR * float(np.median(errors)), OUTLIER_PIXELS):
            break
        outliers.append(kept.pop(worst).name)
    share, deviation = float(coverage(kept, size).mean()), float(np.asarray(deviations).ravel()[:2].max())
    if share < MIN_COVERAGE:
        raise CalibrationRefused(
            f"the board reached {100 * share:.0f} % of the picture; at least {100 * MIN_COVERAGE:.0f} % are needed:"
            " take more pictures with the board near the edges"
        )
    fx, fy, cx, cy = (float(one) for one in np.asarray(matrix)[[0, 1, 0, 1], [0, 1, 2, 2]])
    if not deviation < MAX_FOCAL_DEVIATION * fx:
        raise CalibrationRefused(
            f"the focal length is uncertain by {100 * deviation / fx:.2g} %, more than {100 * MAX_FOCAL_DEVIATION:g} %:"
            " tilt the board by 30 to 45 deg in some pictures, and bring it nearer"
        )
    if not rms < MAX_RMS_PIXELS:
        raise CalibrationRefused(
            f"the corners are {rms:.2f} pixels from the model (RMS), more than {MAX_RMS_PIXELS:g}: take new pictures"
            " with a flat board, and with camera and board at rest"
        )
    k = np.asarray(distortion, np.float64).ravel()[:5].tolist()
    table = {"focal": (fx, fy), "centre": (cx, cy), "distortion": (k[0], k[1], k[2], k[3], k[4])}
    try:
        lens = check(LensFile, table, "the fitted lens")
    except ConfigError as error:
        raise CalibrationRefused(f"{error}: take pictures with the board near the edges and tilted") from None
    return LensResult(lens, float(rms), deviation, share, len(kept), tuple(outliers))


def calibrate_pair(
    first: Sequence[View], second: Sequence[View], lenses: tuple[LensFile, LensFile], size: tuple[int, int],
    square: float,
) -> PairResult:  # fmt: skip
    """Return the pose of the second camera in the frame of the first, from pictures that were taken together.

    Args:
        first, second: views of both cameras; views with the same name were taken at the same time.
        lenses: calibrated lenses of both cameras.
        size: number of columns and rows of the first camera's pictures.
        square: side of the board's squares [m].

    Raises:
        CalibrationRefused: too few pairs show the same corners, or the corners are far from the model.
    """
    corners, others = corner_positions(square), {view.name: view for view in second}
    points: list[NDArray[np.float32]] = []
    pixels: tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]] = [], []
    for view in first:
        other = others.get(view.name)
        if other is None:
            continue
        common, a, b = np.intersect1d(view.numbers, other.numbers, return_indices=True)
        if len(common) >= MIN_CORNERS:
            points.append(np.asarray(corners[common], np.float32))
            pixels[0].append(np.asarray(view.pixels[a], np.float32))
            pixels[1].append(np.asarray(other.pixels[b], np.float32))
    if len(points) < MIN_PAIRS:
        raise CalibrationRefused(
            f"{len(points)} pairs of pictures show the same {MIN_CORNERS} corners; at least {MIN_PAIRS} are needed:"
            " pictures of a pair must have the same file name and be taken while the board is at rest"
        )
    (ka, da), (kb, db) = (_matrices(lens) for lens in lenses)
    rms, *_, rotation, translation, _, _ = cv2.stereoCalibrate(
        points, *pixels, ka, da, kb, db, size, flags=cv2.CALIB_FIX_INTRINSIC
    )
    if not rms < MAX_RMS_PIXELS:
        raise CalibrationRefused(
            f"the corners of both cameras are {rms:.2f} pixels from the model (RMS), more than {MAX_RMS_PIXELS:g}: take"
            " both pictures of a pair at the same time, and do not move the cameras"
        )
    # OpenCV's rotation converts a point from the frame of the first camera to that of the second: p_2 = R p_1 + t.
    turn = np.asarray(rotation, np.float64).T
    position = -turn @ np.asarray(translation, np.float64).ravel()
    return PairResult(_mount(turn, position), float(rms), len(points))


def composed(pose: Mount, relative: Mount) -> Mount:
    """Return the pose of a camera in the world; `relative` is its pose in the frame of a camera at `pose`."""
    return _mount(pose.rotation @ relative.rotation, pose.rotation @ np.array(relative.position) + pose.position)


class Pictured(NamedTuple):
    """The views of the board that one camera has taken."""

    views: list[View]
    size: tuple[int, int]  #: columns and rows of a picture
    device: str | None = None  #: the camera's device; None: not known


class CamerasResult(NamedTuple):
    """Calibration of one camera or of two."""

    lenses: dict[str, LensResult]
    pair: PairResult | None  #: None: one camera
    sentences: tuple[str, ...]  #: human-readable result
    square: float  #: side of the board's squares [m]
    tables: str  #: tables `[cameras.NAME]` with lens and pose

    def toml(self, robot: str | None, made: str) -> str:
        """Return the text of `cameras.toml`.

        Args:
            robot: name of the robot in whose world frame the poses are; None: no pose is known, and a station refuses
                the file as a calibration.
            made: date and source of the calibration.
        """
        head = toml_lines({"format": FORMAT, "robot": robot, "made": made})
        return "\n".join((*head, "", "[board]", *toml_lines({"square": self.square}), "", self.tables))


def calibrate_cameras(pictured: Mapping[str, Pictured], square: float, pose: Mount | None) -> CamerasResult:
    """Return lens and pose of one camera or of two, from pictures of a board.

    Args:
        pictured: views by the name of the camera; `pose` is the pose of the first camera.
        square: side of the board's squares [m].
        pose: pose of the first camera in the world; None: not known.

    Raises:
        CalibrationRefused: the pictures do not determine the lens or the pose; the message names the camera.
    """
    lenses: dict[str, LensResult] = {}
    sentences: list[str] = []
    for name, (views, size, _) in pictured.items():
        try:
            lenses[name] = result = calibrate_lens(views, size, square)
        except CalibrationRefused as error:
            raise CalibrationRefused(f"camera {name}: {error}") from None
        left_out = f"; left out: {', '.join(result.outliers)}" if result.outliers else ""
        sentences.append(
            f"{name}: focal lengths {result.lens.focal[0]:.1f}, {result.lens.focal[1]:.1f} +/-"
            f" {result.focal_deviation:.1f} pixels; corners {result.rms:.2f} pixels from the model (RMS);"
            f" {result.used} of {len(views)} pictures, {100 * result.coverage:.0f} % of the picture{left_out}"
        )
    first, *others = pictured
    tables, pair = [camera_toml(first, pictured[first], lenses[first].lens, pose)], None
    for second in others:
        good = {
            name: [view for view in pictured[name].views if view.name not in lenses[name].outliers]
            for name in (first, second)
        }
        if paired(good[first], good[second]) < MIN_PAIRS:
            good = {name: pictured[name].views for name in (first, second)}
        pair = calibrate_pair(
            good[first], good[second], (lenses[first].lens, lenses[second].lens), pictured[first].size, square
        )
        distance = 1e3 * float(np.linalg.norm(pair.relative.position))
        sentences.append(
            f"{first} and {second}: {distance:.1f} mm apart; corners {pair.rms:.2f} pixels from the model (RMS);"
            f" {pair.used} pairs of pictures"
        )
        placed = composed(pose or Mount(), pair.relative)
        tables.append(camera_toml(second, pictured[second], lenses[second].lens, placed))
        if pose is None:
            sentences.append(f"The pose of {second} is in the frame of {first}, whose pose is not known.")
    return CamerasResult(lenses, pair, tuple(sentences), square, "\n".join(tables))


def camera_toml(name: str, pictured: Pictured, lens: LensFile, pose: Mount | None) -> str:
    """Return the tables of a camera for a station file or a calibration."""

    def row(values: Sequence[float], digits: int) -> str:
        return f"[{', '.join(f'{value:.{digits}g}' for value in values)}]"

    parts: Mapping[str, Mapping[str, str]] = {
        "lens": {"focal": row(lens.focal, 7), "centre": row(lens.centre, 7), "distortion": row(lens.distortion, 6)},
        "pose": {} if pose is None else {
            "position": row(pose.position, 7), "rotation_vector": row(pose.rotation_vector, 7)
        },
    }  # fmt: skip
    tables = (
        f"[cameras.{name}.{part}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items())
        for part, values in parts.items()
        if values
    )
    width, height = pictured.size
    own = toml_lines({"device": pictured.device, "width": width, "height": height})
    return "\n".join((f"[cameras.{name}]\n" + "".join(f"{line}\n" for line in own), *tables))


def _matrices(lens: LensFile) -> tuple[Array, Array]:
    (fx, fy), (cx, cy) = lens.focal, lens.centre
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(lens.distortion)


def _mount(rotation: Array, position: Array) -> Mount:
    vector = np.asarray(cv2.Rodrigues(rotation)[0], np.float64).ravel().tolist()
    x, y, z = position.tolist()
    return Mount(position=(x, y, z), rotation_vector=(vector[0], vector[1], vector[2]))
