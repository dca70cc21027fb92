"""Measure the accuracy of the calibration over many seeds of an uncalibrated bench.

`python -m tests.tools.calibration_seeds [--seeds N] [--first K] [--distortion MM] [--no-runs]`

For each seed a lab is drawn from the preset `uncalibrated`: the tubes differ by up to 8 %, and tracker, coil, sensors
and zeros are unknown. The lab is calibrated from its devices' readings, and the result is compared with the hidden
truth. Then fig6 and fig10 run with this calibration and devices at wire level, and contacts on the shaft are located.
The output is one JSON line per seed, then a table.
"""

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from core.calibration.contact import locate_contact
from core.calibration.measurements import Noise
from core.errors import CtrError
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.calibration import procedures
from station.calibration.files import write_registration, write_robot, write_sensors
from station.calibration.plan import PlanSubject
from station.calibration.static_lab import StaticLab, run_static
from station.config.robots import load_robot
from station.config.strict import PRESETS
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig, load_lab

START = np.array([0.0, math.pi / 2, -0.100])
#: Noise of the load that locates a contact: sensor drift since the last rest without load, and error of the offsets.
CONTACT_NOISE = Noise(force=3e-3, moment=0.2e-3)


def calibrated(lab: LabConfig, seed: int) -> tuple[PlanSubject, StaticLab, procedures.TubesResult]:
    """Return the bench of a seed and the result of its tube calibration."""
    subject = PlanSubject.of(load_robot("paper"), START)
    bench = StaticLab(subject, lab, seed)
    return subject, bench, run_static(procedures.tubes(subject, procedures.Effort()), bench)


def against_truth(bench: StaticLab, found: procedures.TubesResult, path: np.ndarray) -> dict[str, object]:
    """Return the errors of tubes and registration, and the errors of the model at the joints `path` (m, 3)."""
    errors = {}
    for true, new in zip(bench.true_robot.tubes, found.calibration.robot.tubes, strict=True):
        bent, fitted = (math.hypot(*tube.sections[1].curvature) for tube in (true, new))
        errors[f"{true.name}_ei_percent"] = 100.0 * (new.bending_stiffness / true.bending_stiffness - 1.0)
        errors[f"{true.name}_curvature_percent"] = 100.0 * (fitted / bent - 1.0)
    frames, exact, model = found.calibration.frames, ExactRod(bench.true_robot), Statics(found.calibration.robot)
    target, tip, shape = [], [], []
    for k, joints in enumerate(path):
        wrench = np.array([0.5 * (k % 2), 0.0, 0.0, 0.0, 0.0, 0.0])
        true, pose = exact.solve(bench.hidden.joints(joints), wrench), model.solve(joints, wrench)
        target.append(frames.registration.apply(bench.reported_position(true.tip)) - true.tip)
        coil = frames.registration.apply(bench.reported_position(true.tip + true.rotation @ bench.hidden.coil))
        tip.append(coil - pose.rotation @ frames.coil - true.tip)
        shape.append(pose.tip - true.tip)
    for name, vectors in (("target_registration_mm", target), ("tip_mm", tip), ("model_mm", shape)):
        errors[name] = 1e3 * float(np.linalg.norm(np.array(vectors), axis=1).mean())
    believed, described, after = found.held_out_believed, found.held_out_loaded.before, found.held_out_loaded.after
    errors |= {"held_out_believed_mm": 1e3 * float(believed.mean()), "held_out_after_mm": 1e3 * float(after.mean())}
    errors["held_out_best_frames_mm"] = 1e3 * float(described.mean())
    return errors


def contacts(
    subject: PlanSubject, bench: StaticLab, found: procedures.TubesResult, seed: int, count: int
) -> list[dict]:
    """Locate forces of 0.3 N at random positions on the shaft, in random directions; return the errors."""
    random, results = np.random.default_rng([seed, 77]), []
    model = Statics(found.calibration.robot)
    while len(results) < count:
        joints = np.array([random.uniform(-np.pi, np.pi), random.uniform(-np.pi, np.pi), random.uniform(-0.12, -0.02)])
        length = float(joints[2]) + subject.robot.tubes[0].length
        place, direction = random.uniform(0.02, length), random.standard_normal(3)
        try:
            free = bench.measure(joints, 0.0)
            measurement = bench.measure(joints, 0.3, place, direction / np.linalg.norm(direction))
        except CtrError:
            continue
        before, load = (found.sensors.load(subject.robot, each) for each in (free, measurement))
        # The sensors drift, so they are tared at this pose just before the contact.
        load = load._replace(force=load.force - before.force, moment=load.moment - before.moment)
        contact = locate_contact(model, joints, load, CONTACT_NOISE)
        if contact is None:
            continue
        inside = any(start - 1e-3 <= place <= end + 1e-3 for start, end in contact.intervals)
        results.append(
            {"error_mm": 1e3 * abs(contact.arc_length - place), "located": contact.located, "inside": inside}
        )
    return results


def runs(folder: Path, lab: str, seed: int) -> dict[str, object]:
    """Run fig6 and fig10 with the calibration in `folder` and devices at wire level; return their errors."""
    # A calibrated model needs less correction by the tracker, so a lower observer bandwidth admits less noise.
    changes = {"lab": lab, "calibration": str(folder), "controller": {"observer_bandwidth": 1.0}}
    result: dict[str, object] = {}
    for name, case_name in (("fig6", "turn"), ("fig10", "feedforward")):
        case = next(case for case in load_experiment(name, changes).cases if case.name == case_name)
        summary = summarise(run_case(case, seed, VirtualClock(), lambda done: None))
        if name == "fig6":
            result["fig6_loaded_mm"] = summary.get("model_error_mm", {}).get("loaded")
        else:
            result["fig10_true_mm"] = summary.get("true_max_abs_error_mm")
        if not summary["completed"]:
            result[f"{name}_cause"] = summary["cause"]
    return result


def one(seed: int, distortion: float, with_runs: bool) -> dict[str, object]:
    """Return all results of one seed."""
    robot = load_robot("paper")
    config = load_lab("uncalibrated", robot)
    config = config.model_copy(update={"tracker": config.tracker.model_copy(update={"distortion": distortion})})
    subject, bench, found = calibrated(config, seed)
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    path = START + np.stack((0.1 * np.sin(angle), 0.35 * np.sin(angle), 0.010 * np.sin(angle)), axis=1)
    result: dict[str, object] = {"seed": seed, **against_truth(bench, found, path)}
    result["contacts"] = contacts(subject, bench, found, seed, 8)
    if with_runs:
        with tempfile.TemporaryDirectory() as where:
            folder, made = Path(where), f"seed {seed}"
            tubes = found.calibration
            write_registration(folder, subject.robot, tubes.frames, tubes.fit, tubes.errors, GENERATOR_POSE, made)
            write_sensors(folder, subject.robot, found.sensors, made)
            write_robot(folder, subject.file, tubes, made)
            lab = "uncalibrated"
            if distortion > 0.0:
                lab = str(folder / "lab.toml")
                plain = (PRESETS / "labs" / "uncalibrated.toml").read_text(encoding="utf-8")
                Path(lab).write_text(f"{plain}\n[tracker]\ndistortion = {distortion!r}\n", encoding="utf-8")
            result |= runs(folder, lab, seed)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.tools.calibration_seeds", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--distortion", type=float, default=0.0, metavar="MM", help="of the tracker's field, RMS")
    parser.add_argument("--no-runs", action="store_true", help="leave fig6 and fig10 out")
    parsed = parser.parse_args()
    results = []
    for seed in range(parsed.first, parsed.first + parsed.seeds):
        results.append(one(seed, 1e-3 * parsed.distortion, not parsed.no_runs))
        sys.stdout.write(f"{json.dumps(results[-1])}\n")
        sys.stdout.flush()
    for key in results[0]:
        values = [result[key] for result in results if result.get(key) is not None]
        if key not in ("seed", "contacts") and not isinstance(values[0], str):
            sizes = np.abs(values)
            sys.stdout.write(f"{key:28s} median {np.median(sizes, axis=0)} worst {sizes.max(axis=0)}\n")
    found = [contact for result in results for contact in result["contacts"]]
    located = [contact["error_mm"] for contact in found if contact["located"]]
    inside = sum(contact["inside"] for contact in found)
    sys.stdout.write(f"contacts {len(found)}, inside their interval {inside}, located {len(located)}:")
    sys.stdout.write(f" median {np.median(located):.2f} mm, worst {max(located):.1f} mm\n")


if __name__ == "__main__":
    main()
