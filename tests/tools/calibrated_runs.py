"""Measure the controller's errors in a virtual lab that the station has calibrated by itself.

`python -m tests.tools.calibrated_runs [--lab realistic] [--seeds N] [--first K] [--density D] [--load-rate]`

For each seed the bench is calibrated at rest (procedure `tubes`), and the experiments use this calibration with devices
that are simulated at wire level. `--density` gives the lab's tubes another density [kg/m^3] than the robot file has, so
that the controller does not know their weight. `--load-rate` runs every case of the experiment `load_rate` instead, for
the largest true distance. The output is one JSON line per run with the largest errors of x, y and z, then a table with
median and worst of the seeds.
"""

import argparse
import json
import re
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from station.calibration.files import write_registration, write_robot, write_sensors
from station.config.robots import load_robot
from station.config.strict import PRESETS
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import load_lab
from tests.tools.calibration_seeds import calibrated

#: Load of a weight that is lowered by hand within 1.5 s and taken off within 1.5 s.
BY_HAND = {"kind": "ramps", "times": [5.0, 6.5, 15.0, 16.5], "magnitudes": [0.0, 0.5, 0.5, 0.0]}
#: Name, experiment, case and changed keys of each run. The experiment fig10 is shortened to two of its ten periods.
RUNS = (
    ("fig8 as in the paper", "fig8", "type_1", {}),
    ("fig8 live default", "fig8", "regulation", {}),
    ("fig10 feed-forward", "fig10", "feedforward", {"duration": 60.0}),
    ("fig8 as in the paper, lowered by hand", "fig8", "type_1", {"duration": 25.0, "load": BY_HAND}),
    ("fig10 as in the paper", "fig10", "paper", {"duration": 60.0}),
    ("fig6", "fig6", "turn", {}),
    ("fig7", "fig7", "regulation", {"duration": 20.0}),
)
COLUMNS = ("true_max_abs_error_mm", "max_abs_error_mm", "model_error_mm", "true_max_distance_mm")


def write(folder: Path, lab: str, seed: int) -> None:
    """Calibrate the bench of a seed and write the result to a folder."""
    subject, _, found = calibrated(load_lab(lab, load_robot("paper")), seed)
    tubes, made = found.calibration, f"seed {seed}"
    write_registration(folder, subject.robot, tubes.frames, tubes.fit, tubes.errors, GENERATOR_POSE, made)
    write_sensors(folder, subject.robot, found.sensors, made)
    write_robot(folder, subject.file, tubes, made)


def run(folder: Path, lab: str, seed: int, experiment: str, case_name: str, changes: dict) -> dict[str, object]:
    """Run one case with the calibration in `folder`; return its errors."""
    everything = {"lab": lab, "calibration": str(folder), **changes}
    case = next(case for case in load_experiment(experiment, everything).cases if case.name == case_name)
    summary = summarise(run_case(case, seed, VirtualClock(), lambda done: None))
    return {key: summary[key] for key in ("completed", "cause", *COLUMNS) if key in summary}


def _of_density(lab: str, density: float | None, file: Path) -> str:
    """Return the name of the lab's preset, or the path of a copy of it whose tubes have another density."""
    if density is None:
        return lab
    text = (PRESETS / "labs" / f"{lab}.toml").read_text(encoding="utf-8")
    file.write_text(re.sub(r"(?m)^density = \S+", f"density = {density}", text), encoding="utf-8")
    return str(file)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.tools.calibrated_runs", description=__doc__.splitlines()[0])
    parser.add_argument("--lab", default="realistic")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--density", type=float, help="of the lab's tubes [kg/m^3]")
    parser.add_argument("--load-rate", action="store_true", help="run the experiment load_rate instead of the list")
    parsed = parser.parse_args()
    cases = load_experiment("load_rate").cases if parsed.load_rate else ()
    runs = [(case.name, "load_rate", case.name, {}) for case in cases] or RUNS
    table: dict[tuple[str, str], list] = defaultdict(list)
    for seed in range(parsed.first, parsed.first + parsed.seeds):
        with tempfile.TemporaryDirectory() as where:
            lab = _of_density(parsed.lab, parsed.density, Path(where, "lab.toml"))
            write(Path(where), lab, seed)
            for name, experiment, case, changes in runs:
                found = run(Path(where), lab, seed, experiment, case, changes)
                sys.stdout.write(f"{json.dumps({'seed': seed, 'run': name, **found})}\n")
                sys.stdout.flush()
                for key in COLUMNS:
                    if key in found:
                        value = found[key]
                        table[name, key].append(list(value.values()) if isinstance(value, dict) else value)
    for (name, key), values in table.items():
        sys.stdout.write(f"{name:40s} {key:24s} median {np.median(values, axis=0)} worst {np.max(values, axis=0)}\n")


if __name__ == "__main__":
    main()
