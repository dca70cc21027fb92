"""The command `validate`: measured poses of a robot held against its model."""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

from station.cli.options import results_of, tell


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    validate = commands.add_parser(
        "validate", help="measured poses of a robot against its model",
        description="Holds poses that were measured anywhere against the model of a robot.",
        epilog="POSES.csv: a row a pose, in SI units; the first line names the columns: the robot's joints by their"
        " names [rad or m], tip_x, tip_y, tip_z [m]; where there are any force_x, force_y, force_z on the tip, in the"
        " robot's frame [N]; time [s] where the order matters. A translation is the place of the tube's proximal end"
        " from the front plate, never positive. Cells may be empty or nan: such rows are left out, and listed.",
    )  # fmt: skip
    validate.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    validate.add_argument("poses", type=Path, metavar="POSES.csv")
    validate.add_argument(
        "--fit", choices=("none", "frames", "tubes"), default="frames",
        help="none: the tips are in the robot's frame; frames: find a rigid motion and a constant offset of the"
        " measured point from the tip; tubes: find the tubes, too (frames)",
    )  # fmt: skip
    validate.add_argument(
        "--test",
        type=Path,
        metavar="OTHER.csv",
        help="poses to test with (every second of POSES after a fit to the others)",
    )
    validate.add_argument(
        "--hysteresis", action="store_true", help="each joint may lag behind the way that it came; needs a column time"
    )
    validate.add_argument(
        "--out", type=Path, metavar="DIR", help="where results go (validations, in the folder of data if one is given)"
    )
    validate.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    validate.set_defaults(command=_validate)


def _validate(parsed: argparse.Namespace) -> int:
    from station.calibration.validation_output import write_validation

    parsed.out = results_of(parsed, "validations")
    return held(parsed, parsed.fit, parsed.robot, "validate", write_validation)


def held(parsed: argparse.Namespace, fit: Any, robot: str, what: str, write: Any) -> int:
    """Read, fit, write by `write`, print; `parsed` has poses, test, hysteresis, out and json."""
    from station.calibration.folder import new_folder
    from station.calibration.poses import read_poses
    from station.calibration.validation import validate
    from station.calibration.validation_output import sentences, tables
    from station.config.robots import load_robot

    file = load_robot(robot)
    poses = read_poses(parsed.poses, file)
    test = None if parsed.test is None else read_poses(parsed.test, file)
    found = validate(file, poses, fit, test=test, hysteresis=parsed.hysteresis)
    stamp = datetime.now().astimezone()
    folder = new_folder(parsed.out, f"{what}-{poses.path.stem}-{stamp:%Y%m%d-%H%M%S}")
    numbers = write(folder, found, stamp.isoformat(timespec="seconds"))
    if parsed.json:
        sys.stdout.write(f"{json.dumps(numbers)}\n")
        return 0
    tell(tables(found), sentences(found), folder)
    return 0
