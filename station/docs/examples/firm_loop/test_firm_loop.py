"""The loop satisfies the station's contract, and a larger share of compensation gives a smaller error."""

from dataclasses import replace

import firm_loop
import numpy as np
import pytest

from core.control.controllers import INNER_LOOPS, Strategy, strategy
from station.config.loads import RaisedCosineLoad
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case


def error(share: float) -> float:
    """Return the largest true error [mm] while a force of 0.3 N oscillates."""
    case = next(each for each in load_experiment("fig8").cases if each.name == "type_1")
    outer = case.controller.strategy.outer
    controller = replace(case.controller, strategy=Strategy(outer, firm_loop.FirmLoop(share)))
    load = RaisedCosineLoad(peak=0.3, period=2.0)
    file = case.file.model_copy(update={"load": load, "duration": 4.0})
    recording = run_case(case._replace(controller=controller, file=file), 0, VirtualClock(), progress=lambda part: None)
    assert recording.completed
    return max(summarise(recording)["true_max_abs_error_mm"])


def test_import_registers_the_loop_under_its_name():
    assert strategy("dual_layer", inner="firm").inner is INNER_LOOPS["firm"]


def test_full_compensation_has_a_smaller_error_than_none():
    assert error(1.0) < 0.9 * error(0.0)


@pytest.mark.parametrize("name", ["firm"])
def test_loop_is_accepted_at_the_start_pose(name: str):
    case = load_experiment("fig8").cases[0]
    strategy("dual_layer", inner=name).check(case.controller.statics.solve(case.start, np.zeros(6)))
