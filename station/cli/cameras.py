"""The command `cameras`: print the board, and calibrate lenses and the pose of a second camera from pictures of it."""

import argparse
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import number_between, progress_bar, seed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from station.camera.lens_calibration import Pictured
    from station.devices.cameras import CameraFile

#: File name suffixes of pictures.
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
    board.add_argument("--out", type=Path, default=Path("board.svg"), metavar="FILE", help="file (default: board.svg)")
    board.set_defaults(command=_board)
    calibrate = what.add_parser("calibrate", help="calibrate one camera, or two that view the same board")
    calibrate.add_argument(
        "folders", nargs="*", metavar="NAME=FOLDER",
        help="name of a camera and folder of its pictures; pictures of two cameras with the same file name were taken"
        " at the same time",
    )  # fmt: skip
    calibrate.add_argument("--square", **square)
    calibrate.add_argument(
        "--lab", metavar="LAB",
        help="use simulated pictures of a board by the two cameras of this virtual lab, instead of folders",
    )  # fmt: skip
    calibrate.add_argument("--seed", type=seed, default=0, help="seed of the simulated pictures (default: 0)")
    calibrate.add_argument(
        "--config", type=Path, metavar="FILE",
        help="station file with the pose of the first camera; the second gets its pose in the world (default: no pose"
        " is known, and the second pose is relative to the first)",
    )  # fmt: skip
    calibrate.add_argument(
        "--out", type=Path, default=Path("cameras.toml"), metavar="FILE",
        help="output file, to copy into the station file or to use with --calibration (default: cameras.toml)",
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
    from station.camera.lens_calibration import calibrate_cameras
    from station.config.robots import load_robot
    from station.config.strict import ConfigError
    from station.lab.config import load_lab
    from station.recording.run_folder import write_atomically
    from station.service.station_file import load_station

    square = 1e-3 * parsed.square
    station = None if parsed.config is None else load_station(parsed.config)
    robot = None if station is None else load_robot(station.robot).name
    cameras: Mapping[str, CameraFile] = {} if station is None else station.cameras
    if parsed.lab is not None:
        if parsed.folders or parsed.config is not None:
            raise ConfigError("--lab takes simulated pictures: give no folders and no --config")
        robot = "paper"
        cameras = load_lab(parsed.lab, load_robot(robot)).cameras
        if not cameras:
            raise ConfigError(f"--lab {parsed.lab}: this lab has no cameras; choose a lab with cameras")
        found = _simulated(cameras, square, parsed.seed)
    else:
        found = {name: _views(name, Path(folder), cameras.get(name)) for name, folder in _named(parsed.folders).items()}
    first = next(iter(found))
    result = calibrate_cameras(found, square, cameras[first].pose if first in cameras else None)
    sys.stdout.write("".join(f"{sentence}\n" for sentence in result.sentences))
    made = f"'cameras calibrate' of {datetime.now().astimezone().isoformat(timespec='seconds')}"
    write_atomically(result.toml(robot, made), parsed.out)
    use = "" if robot is None else ", or use its folder as a --calibration"
    sys.stdout.write(f"{parsed.out}: copy its tables [cameras.NAME] to the station file{use}\n")
    return 0


def _named(folders: list[str]) -> dict[str, str]:
    """Return the folders by the names of their cameras."""
    from station.config.strict import ConfigError

    named = dict(part.split("=", 1) for part in folders if "=" in part)
    if len(named) != len(folders) or not 1 <= len(named) <= 2:
        raise ConfigError(f"'{' '.join(folders)}': give one or two different cameras as NAME=FOLDER, or --lab")
    return named


def _simulated(cameras: "Mapping[str, CameraFile]", square: float, seed: int) -> "dict[str, Pictured]":
    """Return the corners in simulated pictures of a virtual lab's cameras, and the pictures' columns and rows."""
    from station.camera.board import Corners
    from station.camera.lens_calibration import Pictured, View
    from station.camera.simulated_board import PICTURES, simulated_pictures

    corners = Corners()
    found = {name: Pictured([], (camera.width, camera.height), camera.device) for name, camera in cameras.items()}
    with progress_bar() as bar:
        taken = simulated_pictures(cameras, square, seed)
        for number, pictures in bar.track(taken, total=PICTURES, description="corners in simulated pictures"):
            for name, picture in pictures.items():
                found[name].views.append(View(number, *corners.find(picture)))
    return found


def _views(name: str, folder: Path, camera: "CameraFile | None") -> "Pictured":
    """Return the corners in every picture of a folder, the pictures' columns and rows, and the camera's device."""
    import cv2
    import numpy as np

    from station.camera.board import Corners
    from station.camera.lens_calibration import Pictured, View
    from station.config.strict import ConfigError
    from station.regular_file import is_hidden

    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in PICTURES and not is_hidden(path))
    if not paths:
        raise ConfigError(f"{folder}: no pictures ({', '.join(PICTURES)}); save snapshots of camera '{name}' there")
    corners, views, sizes = Corners(), list[View](), set[tuple[int, int]]()
    with progress_bar() as bar:
        for path in bar.track(paths, description=f"corners of {name}"):
            picture = cv2.imread(str(path))
            if picture is None:
                raise ConfigError(f"{path}: not a readable picture; remove the file or save the picture again")
            sizes.add((picture.shape[1], picture.shape[0]))
            if len(sizes) > 1:
                raise ConfigError(f"{path}: the pictures of a camera must have one size, not {sorted(sizes)}")
            views.append(View(path.stem, *corners.find(np.asarray(picture, np.uint8))))
    return Pictured(views, sizes.pop(), None if camera is None else camera.device)
