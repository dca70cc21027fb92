"""The command `design`: tubes searched for a task."""

import argparse
import hashlib
import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import count, progress_bar, results_of, tell
from station.experiments.side_by_side import processors

if TYPE_CHECKING:
    from station.design.candidates import Candidates, Line
    from station.design.study import Study


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    design = commands.add_parser(
        "design", help="search for tubes that do a task of points and loads better; a robot's file and a report"
    )
    design.add_argument("study", metavar="STUDY", help="preset (fig10_load) or .toml file")
    design.add_argument(
        "--jobs", type=count(1024), default=processors(), metavar="N", help="processes (one a processor)"
    )
    design.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="look at candidates on a Dask cluster, tcp://HOST:PORT; 'local': one here",
    )  # fmt: skip
    design.add_argument(
        "--out", type=Path, metavar="DIR",
        help="where results go (designs, in the folder of data if one is given); the same command goes on there",
    )  # fmt: skip
    design.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    design.set_defaults(command=_design)


def _design(parsed: argparse.Namespace) -> int:
    from station.design.candidates import Candidates, plan_of
    from station.design.design_output import sentences, tables, write_design
    from station.design.outcome import design, summary
    from station.design.study import load_study
    from station.experiments.on_cluster import check_dask

    if parsed.scheduler is not None:
        check_dask()
    study = load_study(parsed.study)
    digest = hashlib.sha256(json.dumps(plan_of(study), sort_keys=True).encode()).hexdigest()
    folder = results_of(parsed, "designs") / f"design-{study.name}-{digest[:8]}"
    with Candidates(folder, study) as candidates:
        lines = _searched(study, candidates, parsed)
        found = design(study, lines)
        said = summary(found)
        write_design(folder, found, said)
    if parsed.json:
        sys.stdout.write(f"{json.dumps({**said, 'folder': str(folder)})}\n")
        return 0
    tell(tables(said), sentences(said), folder)
    return 0


def _searched(study: "Study", candidates: "Candidates", parsed: argparse.Namespace) -> "list[Line]":
    """All candidates; a bar with how many there are and the time left."""
    from station.design.engines import engine
    from station.design.search import planned, search

    with progress_bar(over=3600.0) as bar:
        task = bar.add_task(f"design {study.name}", total=planned(study))
        say = partial(bar.console.print, markup=False, soft_wrap=True)

        def told(asked: int) -> None:
            best = min((line["cost"] for line in candidates.lines.values()), default=0.0)
            bar.update(task, completed=asked, description=f"design {study.name}, best {-best:.3f}")

        with engine(parsed.jobs, parsed.scheduler, say) as look:
            return search(study, candidates, look, told)
