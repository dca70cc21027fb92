"""The command `design`: search for tubes that suit a task."""

import argparse
import hashlib
import json
from typing import Any

from station.cli.options import add_results, add_workers, print_result, progress_bar, result_folder, started_workers


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `design` to the parser."""
    design = commands.add_parser(
        "design",
        help="search for better tubes for a task of points and loads; writes a robot file and a report",
        epilog="Repeating the command continues an incomplete search.",
    )
    design.add_argument("study", metavar="STUDY", help="preset (fig10_load) or .toml file")
    add_workers(design)
    add_results(design, "designs")
    design.set_defaults(command=_design)


def _design(parsed: argparse.Namespace) -> int:
    from station.design.design_report import sentences, tables, write_design
    from station.design.outcome import design, summary
    from station.design.search import candidates_file, plan_of, planned, search
    from station.design.study import load_study

    study = load_study(parsed.study)
    digest = hashlib.sha256(json.dumps(plan_of(study), sort_keys=True).encode()).hexdigest()
    folder, most = result_folder(parsed, "designs") / f"design-{study.name}-{digest[:8]}", planned(study)
    with candidates_file(folder, study) as stored:
        with progress_bar(over=3600.0) as bar, started_workers(parsed, most, bar) as workers:
            task = bar.add_task(f"design {study.name}", total=most)

            def report(evaluated: int) -> None:
                best = min((line["cost"] for line in stored.rows.values()), default=0.0)
                bar.update(task, completed=evaluated, description=f"design {study.name}, best {-best:.3f}")

            lines = search(study, stored, workers, report)
        found = design(study, lines)
        numbers = summary(found)
        write_design(folder, found, numbers)
    return print_result(parsed, numbers, tables(numbers), sentences(numbers), folder)
