"""The sawtooth load acts on the simulated robot, and the controller estimates it."""

import numpy as np
import pytest
from saw_load import SawLoad

from station.config.loads import InstalledLoad
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case

LOAD = SawLoad(peak=0.3, period=2.0)


@pytest.mark.parametrize(("time", "force"), [(1.0, 0.15), (1.99, 0.2985), (2.0, 0.0), (3.0, 0.15)])
def test_force_grows_and_drops_to_zero_each_period(time: float, force: float):
    assert LOAD.force(time) == pytest.approx([force, 0.0, 0.0])


def test_controller_estimates_the_force_that_acts_on_the_robot():
    load = InstalledLoad(name="saw", options={"peak": 0.3, "period": 2.0})
    case = next(each for each in load_experiment("fig8").cases if each.name == "type_2")
    case = case._replace(file=case.file.model_copy(update={"load": load, "duration": 3.9}))
    recording = run_case(case, 0, VirtualClock(), progress=lambda part: None)
    true, estimated = (recording.channels.of(recording.rows, name)[:, 0] for name in ("force_true", "force"))
    assert recording.completed
    assert true.max() == pytest.approx(0.3, abs=0.01)
    assert np.sqrt(np.mean((estimated - true) ** 2)) < 0.05
