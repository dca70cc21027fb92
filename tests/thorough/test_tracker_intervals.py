"""The intervals of `calibrate tracker` contain the true poses of tracker and coil, although the tubes are wrong."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.calibration.catalogue import start_procedure
from station.calibration.plan import PlanSubject
from station.calibration.static_lab import StaticLab, run_static
from station.cli.calibrate import robot_start
from station.config.robots import load_robot
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig, load_lab


@pytest.mark.parametrize("lab", ["default", "ideal", "uncalibrated"])
@pytest.mark.parametrize("robot", ["paper", "three_tubes", "nylon"])
def test_95_percent_intervals_of_40_seeds_contain_the_truth(robot, lab):
    file = load_robot(robot)
    subject = PlanSubject.of(file, robot_start(file))
    config = LabConfig() if lab == "default" else load_lab(lab, file)
    inside = []
    for seed in range(40):
        bench = StaticLab(subject, config, seed)
        found = run_static(start_procedure("tracker", subject), bench).registration
        turn = bench.generator.rotation @ GENERATOR_POSE.rotation.T
        shift = bench.generator.position - turn @ GENERATOR_POSE.position
        # Rotation and position are estimated about the middle of the measured points.
        point = turn.T @ (found.middle - shift)
        registration = found.frames.registration
        errors = {"frame rotation": Rotation.from_matrix(registration.rotation @ turn.T).as_rotvec(),
                  "frame position": registration.apply(point[None])[0] - found.middle,
                  "coil": found.frames.coil - bench.hidden.coil}  # fmt: skip
        inside += [
            abs(error) < found.fit.interval(f"{name} {axis}")
            for name, vector in errors.items()
            for axis, error in zip("xyz", vector, strict=True)
        ]
    # The default lab has the same tubes for every seed: their error is one draw, which may be smaller than usual.
    assert 0.90 <= np.mean(inside) <= (1.0 if lab == "default" else 0.995)
