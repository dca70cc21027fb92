"""The command `validate`: compare measured poses of a robot with its model."""

import argparse
from datetime import datetime
from pathlib import Path
from typing import Any

from station.cli.options import add_results, print_result, progress_bar, result_folder


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `validate` to the parser."""
    validate = commands.add_parser(
        "validate", help="compare measured poses of a robot with its model",
        description="Compare measured poses of a robot with its model. The poses may come from any setup.",
        epilog="POSES.csv has one row for each pose, in SI units. The first line names the columns: the robot's joints"
        " by their names [rad or m]; tip_x, tip_y, tip_z [m]; optionally force_x, force_y, force_z on the tip, in the"
        " robot's frame [N]; time [s] where the order matters; trajectory, a number: the poses of one"
        " trajectory are held out together (default: five parts). A translation is the position of the tube's proximal"
        " end relative to the front plate and never positive. Rows with empty or nan cells are skipped and listed.",
    )  # fmt: skip
    add_columns(validate)
    validate.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    validate.add_argument("poses", type=Path, metavar="POSES.csv")
    validate.add_argument(
        "--fit", choices=("none", "frames", "tubes", "friction", "residual"), default="frames",
        help="none: the tips are in the robot's frame; frames: fit a rigid transform and a constant offset of the"
        " measured point from the tip; tubes: also fit the tubes; friction: also fit how far the motions before a pose"
        " have wound up each tube, needs a column time; residual: also learn the rest of the error as a"
        " function of joints, last motions and load (default: frames)",
    )  # fmt: skip
    validate.add_argument(
        "--test",
        type=Path,
        metavar="OTHER.csv",
        help="poses for the test (default: every second pose of POSES; the fit uses the others)",
    )
    validate.add_argument(
        "--hysteresis",
        action="store_true",
        help="fit a lag of each joint that depends on its direction of travel; needs a column time",
    )
    add_results(validate, "validations")
    validate.set_defaults(command=_validate)


def add_columns(command: argparse.ArgumentParser) -> None:
    """Add the option `--columns` to a command that reads poses."""
    command.add_argument(
        "--columns", type=lambda text: text.split(","), default=[], metavar="NAME=COLUMN[UNIT],...",
        help="columns of a table from another laboratory, with their units: tip_x=X[mm],outer_rotation=theta[deg],"
        "inner_translation=-d[mm]; NAME=COLUMN[mm]-0.15 adds an offset in metres; #3 is the third column. Columns that"
        " are not named are ignored. The first sheet of Excel files (.xlsx) is read, too, and MATLAB files (.mat, not"
        " version 7.3): there P#1 is the first column of P, or the x of homogeneous transforms (4, 4, m) or (m, 4, 4)",
    )  # fmt: skip


def _validate(parsed: argparse.Namespace) -> int:
    from station.calibration.validation_output import write_validation

    parsed.out = result_folder(parsed, "validations")
    return run_validation(parsed, parsed.fit, parsed.robot, "validate", write_validation)


def run_validation(parsed: argparse.Namespace, fit: Any, robot: str, what: str, write: Any) -> int:
    """Read poses, fit, write the results with `write` and print them.

    `parsed` has the options `poses`, `test`, `columns`, `hysteresis`, `out` and `json`.
    """
    from station.calibration.columns import column_choice
    from station.calibration.files import new_folder
    from station.calibration.poses import read_poses
    from station.calibration.validation import validate
    from station.calibration.validation_output import sentences, tables
    from station.config.robots import load_robot

    file, choices = load_robot(robot), [column_choice(text) for text in parsed.columns]
    poses = read_poses(parsed.poses, file, choices)
    test = None if parsed.test is None else read_poses(parsed.test, file, choices)
    with progress_bar() as bar:
        task = bar.add_task(f"fit {len(poses.measurements)} poses", total=1.0)
        found = validate(
            file, poses, fit, test=test, hysteresis=parsed.hysteresis,
            progress=lambda share: bar.update(task, completed=share),
        )  # fmt: skip
    stamp = datetime.now().astimezone()
    folder = new_folder(parsed.out, f"{what}-{poses.path.stem}-{stamp:%Y%m%d-%H%M%S}")
    numbers = write(folder, found, stamp.isoformat(timespec="seconds"))
    return print_result(parsed, numbers, tables(found), sentences(found), folder)
