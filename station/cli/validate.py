"""The command `validate`: compare measured poses of a robot with its model."""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

from station.cli.options import print_result, result_folder


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `validate` to the parser."""
    validate = commands.add_parser(
        "validate", help="compare measured poses of a robot with its model",
        description="Compare measured poses of a robot with its model. The poses may come from any setup.",
        epilog="POSES.csv has one row for each pose, in SI units. The first line names the columns: the robot's joints"
        " by their names [rad or m]; tip_x, tip_y, tip_z [m]; optionally force_x, force_y, force_z on the tip, in the"
        " robot's frame [N]; time [s] where the order matters. A translation is the position of the tube's proximal"
        " end relative to the front plate and never positive. Rows with empty or nan cells are skipped and listed.",
    )  # fmt: skip
    validate.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    validate.add_argument("poses", type=Path, metavar="POSES.csv")
    validate.add_argument(
        "--fit", choices=("none", "frames", "tubes", "friction"), default="frames",
        help="none: the tips are in the robot's frame; frames: fit a rigid transform and a constant offset of the"
        " measured point from the tip; tubes: also fit the tubes; friction: also fit how far the motions before a pose"
        " have wound up each tube, needs a column time (default: frames)",
    )  # fmt: skip
    validate.add_argument(
        "--test",
        type=Path,
        metavar="OTHER.csv",
        help="poses for the test (default: every second pose of POSES after a fit to the others)",
    )
    validate.add_argument(
        "--hysteresis",
        action="store_true",
        help="fit a lag of each joint that depends on its direction of travel; needs a column time",
    )
    validate.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of results (validations, inside --data if given)"
    )
    validate.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    validate.set_defaults(command=_validate)


def _validate(parsed: argparse.Namespace) -> int:
    from station.calibration.validation_output import write_validation

    parsed.out = result_folder(parsed, "validations")
    return run_validation(parsed, parsed.fit, parsed.robot, "validate", write_validation)


def run_validation(parsed: argparse.Namespace, fit: Any, robot: str, what: str, write: Any) -> int:
    """Read poses, fit, write the results with `write` and print them.

    `parsed` has the options `poses`, `test`, `hysteresis`, `out` and `json`.
    """
    from station.calibration.files import new_folder
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
    print_result(tables(found), sentences(found), folder)
    return 0
