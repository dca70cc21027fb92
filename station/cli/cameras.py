"""The command `cameras`: print the board, and calibrate lenses and the pose of a second camera from pictures of it."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import number_between, progress_bar, seed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from station.camera.lens_calibration import LensResult, View
    from station.devices.cameras import CameraFile

#: Endings of picture files.
PICTURES = (".jpg", ".jpeg", ".png", ".bmp")


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `cameras` to the parser."""
    cameras = commands.add_parser("cameras", help="print a board, and calibrate cameras from pictures of it")
    what = cameras.add_subparsers(title="commands", metavar="COMMAND", required=True)
    square = {
        "type": number_between(5.0, 200.0, "a length", "mm"), "default": 35.0, "metavar": "MM",
        "help": "side of a square of the board, measured on the print [mm] (default: 35)",
    }  # fmt: skip
    board = what.add_parser("board", help="write the board as an SVG file, to print in true size")
    board.add_argument("--square", **square)
    board.add_argument("--out", type=Path, default=Path("board.svg"), metavar="FILE", help="(default: board.svg)")
    board.set_defaults(command=_board)
    calibrate = what.add_parser("calibrate", help="calibrate one camera, or two that look at the same board")
    calibrate.add_argument(
        "folders", nargs="*", metavar="NAME=FOLDER",
        help="name of a camera and folder of its pictures; pictures of two cameras with the same file name were taken"
        " at the same time",
    )  # fmt: skip
    calibrate.add_argument("--square", **square)
    calibrate.add_argument(
        "--lab", metavar="LAB",
        help="virtual lab with two cameras, which take simulated pictures of a board, instead of folders",
    )  # fmt: skip
    calibrate.add_argument("--seed", type=seed, default=0, help="seed of the simulated pictures (default: 0)")
    calibrate.add_argument(
        "--config", type=Path, metavar="FILE",
        help="station file with the pose of the first camera; the second gets its pose in the world (default: no pose"
        " is known, and the second pose is relative to the first)",
    )  # fmt: skip
    calibrate.add_argument(
        "--out", type=Path, default=Path("cameras.toml"), metavar="FILE",
        help="tables for the station file, or for a folder of --calibration (default: cameras.toml)",
    )  # fmt: skip
    calibrate.set_defaults(command=_calibrate)


def _check_extra() -> None:
    from station.devices.cameras import CameraFile, check_cameras

    check_cameras({"NAME": CameraFile()}, virtual=True)


def _board(parsed: argparse.Namespace) -> int:
    _check_extra()
    from station.camera.board import board_svg

    parsed.out.write_text(board_svg(1e-3 * parsed.square), encoding="utf-8")
    sys.stdout.write(f"{parsed.out}: print it at 100 %, and measure the line of 100 mm\n")
    return 0


def _calibrate(parsed: argparse.Namespace) -> int:
    _check_extra()
    from station.camera.lens_calibration import calibrate_lens, calibrate_pair, camera_toml, composed
    from station.config.robots import load_robot
    from station.config.strict import ConfigError
    from station.devices.config import Mount
    from station.lab.config import load_lab
    from station.recording.run_folder import write_atomically
    from station.service.station_file import load_station

    square = 1e-3 * parsed.square
    cameras: Mapping[str, CameraFile] = {} if parsed.config is None else load_station(parsed.config).cameras
    if parsed.lab is not None:
        if parsed.folders or parsed.config is not None:
            raise ConfigError("--lab takes simulated pictures: give no folders and no --config")
        cameras = load_lab(parsed.lab, load_robot("paper")).cameras
        if not cameras:
            raise ConfigError(f"--lab {parsed.lab}: this lab has no cameras")
        found = _simulated(cameras, square, parsed.seed)
    else:
        found = {name: _views(name, Path(folder)) for name, folder in _named(parsed.folders).items()}
    results: dict[str, LensResult] = {}
    for name, (views, size) in found.items():
        results[name] = result = calibrate_lens(views, size, square)
        left_out = f"; left out: {', '.join(result.outliers)}" if result.outliers else ""
        sys.stdout.write(
            f"{name}: focal lengths {result.lens.focal[0]:.1f}, {result.lens.focal[1]:.1f} +/-"
            f" {result.focal_deviation:.1f} pixels; corners {result.rms:.2f} pixels from the model (RMS);"
            f" {result.used} of {len(views)} pictures, {100 * result.coverage:.0f} % of the picture{left_out}\n"
        )
    first, *others = found
    pose = cameras[first].pose if first in cameras else None
    tables = [camera_toml(first, results[first].lens, pose)]
    for second in others:
        size = found[first][1]
        views, other_views = (
            [view for view in found[name][0] if view.name not in results[name].outliers] for name in (first, second)
        )
        pair = calibrate_pair(views, other_views, (results[first].lens, results[second].lens), size, square)
        distance = 1e3 * sum(one * one for one in pair.relative.position) ** 0.5
        sys.stdout.write(
            f"{first} and {second}: {distance:.1f} mm apart; corners {pair.rms:.2f} pixels from the model (RMS);"
            f" {pair.used} pairs of pictures\n"
        )
        tables.append(camera_toml(second, results[second].lens, composed(pose or Mount(), pair.relative)))
        if pose is None:
            sys.stdout.write(f"The pose of {second} is in the frame of {first}, whose pose is not known.\n")
    write_atomically("\n".join(tables), parsed.out)
    sys.stdout.write(f"{parsed.out}: copy its tables to the station file, or its folder is a --calibration\n")
    return 0


def _named(folders: list[str]) -> dict[str, str]:
    """Return the folders by the names of their cameras."""
    from station.config.strict import ConfigError

    named = dict(part.split("=", 1) for part in folders if "=" in part)
    if len(named) != len(folders) or not 1 <= len(named) <= 2:
        raise ConfigError(f"'{' '.join(folders)}': give one or two different cameras as NAME=FOLDER, or --lab")
    return named


def _simulated(
    cameras: "Mapping[str, CameraFile]", square: float, seed: int
) -> "dict[str, tuple[list[View], tuple[int, int]]]":
    """Return the corners in simulated pictures of a virtual lab's cameras, and the pictures' columns and rows."""
    from station.camera.board import Corners
    from station.camera.lens_calibration import View
    from station.camera.simulated_board import PICTURES, simulated_pictures

    corners = Corners()
    found = {name: (list[View](), (camera.width, camera.height)) for name, camera in cameras.items()}
    with progress_bar() as bar:
        taken = simulated_pictures(cameras, square, seed)
        for number, pictures in bar.track(taken, total=PICTURES, description="corners in simulated pictures"):
            for name, picture in pictures.items():
                found[name][0].append(View(number, *corners.find(picture)))
    return found


def _views(name: str, folder: Path) -> "tuple[list[View], tuple[int, int]]":
    """Return the corners in every picture of a folder, and the pictures' columns and rows."""
    import cv2
    import numpy as np

    from station.camera.board import Corners
    from station.camera.lens_calibration import View
    from station.config.strict import ConfigError

    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in PICTURES)
    if not paths:
        raise ConfigError(f"{folder}: no pictures ({', '.join(PICTURES)}); save snapshots of camera '{name}' there")
    corners, views, sizes = Corners(), list[View](), set[tuple[int, int]]()
    with progress_bar() as bar:
        for path in bar.track(paths, description=f"corners of {name}"):
            picture = cv2.imread(str(path))
            if picture is None:
                raise ConfigError(f"{path}: not a picture")
            sizes.add((picture.shape[1], picture.shape[0]))
            if len(sizes) > 1:
                raise ConfigError(f"{path}: the pictures of a camera must have one size, not {sorted(sizes)}")
            views.append(View(path.stem, *corners.find(np.asarray(picture, np.uint8))))
    return views, sizes.pop()
