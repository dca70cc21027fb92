"""Cases of preset experiments, shortened for tests that do not need their results, and their runs in virtual time."""

from typing import Any

from station.control.clock import VirtualClock
from station.experiments.experiment import Case, offered_experiment
from station.experiments.runner import Recording, run_case

#: Text of an experiment file: one second at rest without a load.
SHORT = """
title = "short"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 1.0
settling = 0.0
[trajectory]
kind = "hold"
"""


def a_case(experiment: str, name: str, **changes: Any) -> Case:
    """Return a case of a preset experiment with some keys of its file changed."""
    found = next(case for case in offered_experiment(experiment).cases if case.name == name)
    return found._replace(file=found.file.model_copy(update=changes))


def a_run(case: Case, seed: int = 0) -> Recording:
    """Run a case in virtual time and return its recording."""
    return run_case(case, seed, VirtualClock(), lambda _: None)
