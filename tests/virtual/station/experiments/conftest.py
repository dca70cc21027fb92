"""Cases cut short, so that a test of the way and not of the result takes a moment."""

from collections.abc import Callable
from typing import Any

import pytest

from station.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import Recording, run_case


@pytest.fixture(scope="session")
def a_case() -> Callable[..., Case]:
    """A case of a preset with parts of its file changed."""

    def case(experiment: str, name: str, **changes: Any) -> Case:
        found = next(case for case in load_experiment(experiment).cases if case.name == name)
        return found._replace(file=found.file.model_copy(update=changes))

    return case


@pytest.fixture(scope="session")
def a_run() -> Callable[..., Recording]:
    """Run a case in virtual time."""

    def run(case: Case, seed: int = 0) -> Recording:
        return run_case(case, seed, VirtualClock(), lambda _: None)

    return run
