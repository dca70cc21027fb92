"""Cases of the presets, cut short where the way is tested and not the result, and their runs in virtual time."""

from typing import Any

from station.control.clock import VirtualClock
from station.experiments.experiment import Case, offered
from station.experiments.runner import Recording, run_case

#: One second at rest under no load, counted from the start.
SHORT = """
title = "short"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 1.0
settling = 0.0
[trajectory]
kind = "hold"
"""


def a_case(experiment: str, name: str, **changes: Any) -> Case:
    """A case of a preset with parts of its file changed."""
    found = next(case for case in offered(experiment).cases if case.name == name)
    return found._replace(file=found.file.model_copy(update=changes))


def a_run(case: Case, seed: int = 0) -> Recording:
    """What came of it."""
    return run_case(case, seed, VirtualClock(), lambda _: None)
