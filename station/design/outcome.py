"""What came of a search: the robot that it began from and the one that it found, looked at in full."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from core.errors import CtrError
from station.config.robots import RobotFile
from station.control.margins import Margins, check_design
from station.design import candidates
from station.design.candidates import Line
from station.design.exact import Exact, exact
from station.design.study import Study, largest, unit
from station.design.task import Held, Outcome, done


@dataclass(frozen=True)
class Looked:
    """A robot and what it does with the task."""

    file: RobotFile
    outcome: Outcome
    exact: Exact | None  #: under the task's forces
    exact_most: Exact | None  #: under the largest that it holds


@dataclass(frozen=True)
class Design:
    """A search that is done."""

    study: Study
    lines: Sequence[Line]  #: in the order in which they were asked for
    before: Looked
    after: Looked


def design(study: Study, lines: Sequence[Line]) -> Design:
    """Look at the beginning and at the best of the candidates once more, with growing loads and the exact rod."""
    found = candidates.best(lines)
    return Design(study, lines, _looked(study, study.robot), _looked(study, named(study, found)))


def named(study: Study, line: Line) -> RobotFile:
    """A candidate as a robot with a name of its own.

    Raises:
        ConfigError: it cannot be.

    """
    file = study.changed(line["parameters"])
    said = ", ".join(f"{key} = {value:.5g}" for key, value in candidates.of(study, line).items())
    source = f"'{study.robot.name}' with what 'ctr-station design {study.name}' has found: {said}"
    return file.model_copy(update={"name": f"{study.robot.name}-{study.name}", "source": source})


def _looked(study: Study, file: RobotFile) -> Looked:
    task = study.file.task
    outcome = done(file, task, study.file.objective)
    if outcome.held is not None:  # where motions along the task have room: without a load, or under the least
        least = min(range(len(task.forces)), key=lambda row: largest([task.forces[row]]))
        pose = outcome.held.joints[least, len(task.points) // 2]
        names = [joint.name for joint in file.joints]
        file = file.model_copy(update={"working_pose": dict(zip(names, pose.tolist(), strict=True))})
    return Looked(file, outcome, _exact(study, file, outcome.held), _exact(study, file, outcome.most))


def _exact(study: Study, file: RobotFile, held: Held | None) -> Exact | None:
    try:
        return None if held is None else exact(file, study.file.task, held)
    except CtrError:
        return None


def summary(found: Design) -> dict[str, Any]:
    """The numbers, for people in N and mm; ready for JSON."""
    study = found.study
    before, after = (_numbers(study, looked) for looked in (found.before, found.after))
    return {
        "study": study.name,
        "title": study.file.title,
        "objective": study.file.objective,
        "candidates": len({tuple(line["parameters"]) for line in found.lines}),
        "better": candidates.best(found.lines)["cost"] < found.lines[0]["cost"],
        "before": before,
        "after": after,
        "gain": {
            name: round(after[name] / before[name], 4)
            for name in ("largest_force_n", "least_margin", "least_dexterity_mm_s", "least_stiffness_n_m")
            if before[name] and after[name] is not None
        },
        "parameters": [
            {
                "key": parameter.key, "unit": unit(parameter.key), "before": was, "after": now,
                "lower": parameter.lower, "upper": parameter.upper,
            }
            for parameter, was, now in zip(
                study.file.parameters, study.begun.tolist(), candidates.best(found.lines)["parameters"], strict=True
            )
        ],
        "warning": check_design(found.after.file, Margins()),
    }  # fmt: skip


def _numbers(study: Study, looked: Looked) -> dict[str, Any]:
    outcome, held = looked.outcome, looked.outcome.held
    return {
        "robot": looked.file.name,
        "times_the_load": round(outcome.load, 4),
        "largest_force_n": round(outcome.load * largest(study.file.task.forces), 4),
        "then": outcome.why,
        "least_margin": None if held is None else round(float(held.margins.min()), 5),
        "least_dexterity_mm_s": None if held is None else round(1e3 * float(held.dexterities.min()), 4),
        "least_stiffness_n_m": None if held is None else round(float(held.stiffnesses.min()), 3),
        "exact_away_mm": None if looked.exact is None else round(1e3 * looked.exact.away, 4),
        "exact_margin": None if looked.exact is None else round(looked.exact.margin, 5),
        "exact_away_under_largest_mm": None if looked.exact_most is None else round(1e3 * looked.exact_most.away, 4),
        "exact_margin_under_largest": None if looked.exact_most is None else round(looked.exact_most.margin, 5),
    }
