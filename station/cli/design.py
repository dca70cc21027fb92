"""The command `design`: search for tubes that suit a task."""

import argparse
import hashlib
import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import count, print_result, progress_bar, result_folder
from station.experiments.job_pool import processors

if TYPE_CHECKING:
    from station.design.search import Candidates, Line
    from station.design.study import Study


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `design` to the parser."""
    design = commands.add_parser(
        "design", help="search for better tubes for a task of points and loads; writes a robot file and a report"
    )
    design.add_argument("study", metavar="STUDY", help="preset (fig10_load) or .toml file")
    design.add_argument(
        "--jobs", type=count(1024), default=processors(), metavar="N", help="processes (default: one per processor)"
    )
    design.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="evaluate candidates on a Dask cluster, tcp://HOST:PORT; 'local': a cluster on this computer",
    )  # fmt: skip
    design.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder of results (designs, inside --data if given); repeating the command continues the search",
    )  # fmt: skip
    design.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    design.set_defaults(command=_design)


def _design(parsed: argparse.Namespace) -> int:
    from station.design.design_report import sentences, tables, write_design
    from station.design.outcome import design, summary
    from station.design.search import Candidates, plan_of
    from station.design.study import load_study
    from station.experiments.dask_cluster import check_dask

    if parsed.scheduler is not None:
        check_dask()
    study = load_study(parsed.study)
    digest = hashlib.sha256(json.dumps(plan_of(study), sort_keys=True).encode()).hexdigest()
    folder = result_folder(parsed, "designs") / f"design-{study.name}-{digest[:8]}"
    with Candidates(folder, study) as candidates:
        lines = _run_search(study, candidates, parsed)
        found = design(study, lines)
        numbers = summary(found)
        write_design(folder, found, numbers)
    if parsed.json:
        sys.stdout.write(f"{json.dumps({**numbers, 'folder': str(folder)})}\n")
        return 0
    print_result(tables(numbers), sentences(numbers), folder)
    return 0


def _run_search(study: "Study", candidates: "Candidates", parsed: argparse.Namespace) -> "list[Line]":
    """Evaluate all candidates; show a progress bar with their number and the remaining time."""
    from station.design.search import planned, search, search_engine

    with progress_bar(over=3600.0) as bar:
        task = bar.add_task(f"design {study.name}", total=planned(study))
        log = partial(bar.console.print, markup=False, soft_wrap=True)

        def progress(evaluated: int) -> None:
            best = min((line["cost"] for line in candidates.lines.values()), default=0.0)
            bar.update(task, completed=evaluated, description=f"design {study.name}, best {-best:.3f}")

        with search_engine(parsed.jobs, parsed.scheduler, log) as evaluate:
            return search(study, candidates, evaluate, progress)
