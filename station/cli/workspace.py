"""The command `workspace`: what given tubes can do all over their joint space."""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

from station.cli.options import between, count, progress_bar, results_of, seed, tell

#: Largest part of a force [N].
MOST = 100.0


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    workspace = commands.add_parser(
        "workspace", help="reach, dexterity, stiffness and margin of a robot over its joint space, with a report"
    )
    workspace.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    workspace.add_argument(
        "--force", nargs=3, type=between(-MOST, MOST, "a force", "N"), default=[0.0, 0.0, 0.0],
        metavar=("X", "Y", "Z"), help="at the tip, world frame [N] (0 0 0)",
    )  # fmt: skip
    workspace.add_argument("--poses", type=count(1_000_000), default=20_000, metavar="N", help="how many (20000)")
    workspace.add_argument("--seed", type=seed, default=0, metavar="N", help="of the poses (0)")
    workspace.add_argument(
        "--out", type=Path, metavar="DIR", help="where results go (workspaces, in the folder of data if one is given)"
    )
    workspace.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    workspace.set_defaults(command=_workspace)


def _workspace(parsed: argparse.Namespace) -> int:
    import numpy as np

    from station.calibration.folder import new_folder
    from station.config.robots import load_robot
    from station.design.workspace import summary, workspace
    from station.design.workspace_output import sentences, table, write_workspace

    file = load_robot(parsed.robot)
    with progress_bar() as bar:
        task = bar.add_task(f"workspace of {file.name}", total=1.0)
        found = workspace(
            file, np.array(parsed.force), parsed.poses, parsed.seed, lambda part: bar.update(task, completed=part)
        )
    said = summary(found)
    stamp = datetime.now().astimezone()
    folder = new_folder(results_of(parsed, "workspaces"), f"workspace-{_named(file.name)}-{stamp:%Y%m%d-%H%M%S}")
    write_workspace(folder, found, said)
    if parsed.json:
        sys.stdout.write(f"{json.dumps({**said, 'folder': str(folder)})}\n")
        return 0
    tell([table(said)], sentences(said), folder)
    return 0


def _named(name: str) -> str:
    """A robot's name as a part of a folder's."""
    return "".join(each if each.isalnum() or each in "-_" else "-" for each in name)[:40]
