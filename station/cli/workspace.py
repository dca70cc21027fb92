"""The command `workspace`: analyse reach, dexterity, stiffness and stability of a robot over its joint space."""

import argparse
from datetime import datetime
from typing import Any

from station.cli.options import add_results, count, number_between, print_result, progress_bar, result_folder, seed

#: Largest absolute value of a component of the tip force that the option `--force` accepts [N].
MAX_FORCE_N = 100.0


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `workspace` to the parser."""
    workspace = commands.add_parser(
        "workspace", help="analyse reach, dexterity, stiffness and stability margin of a robot over its joint space"
    )
    workspace.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    workspace.add_argument(
        "--force", nargs=3, type=number_between(-MAX_FORCE_N, MAX_FORCE_N, "a force", "N"), default=[0.0, 0.0, 0.0],
        metavar=("X", "Y", "Z"), help="force at the tip, world frame [N] (default: 0 0 0)",
    )  # fmt: skip
    workspace.add_argument(
        "--poses", type=count(1_000_000), default=20_000, metavar="N", help="number of poses (default: 20000)"
    )
    workspace.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the poses (default: 0)")
    add_results(workspace, "workspaces")
    workspace.set_defaults(command=_workspace)


def _workspace(parsed: argparse.Namespace) -> int:
    import numpy as np

    from station.calibration.files import new_folder
    from station.config.robots import load_robot
    from station.design.workspace import summary, workspace
    from station.design.workspace_report import sentences, table, write_workspace

    file = load_robot(parsed.robot)
    with progress_bar() as bar:
        task = bar.add_task(f"workspace of {file.name}", total=1.0)
        found = workspace(
            file, np.array(parsed.force), parsed.poses, parsed.seed, lambda part: bar.update(task, completed=part)
        )
    numbers = summary(found)
    stamp = datetime.now().astimezone()
    folder = new_folder(
        result_folder(parsed, "workspaces"), f"workspace-{_folder_part(file.name)}-{stamp:%Y%m%d-%H%M%S}"
    )
    write_workspace(folder, found, numbers)
    return print_result(parsed, numbers, [table(numbers)], sentences(numbers), folder)


def _folder_part(name: str) -> str:
    """Return a robot's name as part of a folder name."""
    return "".join(each if each.isalnum() or each in "-_" else "-" for each in name)[:40]
