"""Measure the controller over seeds of the lab, for example with and without the use of moments.

`python -m tests.tools.force_before_after NAME... [--seeds 31 32 ...] [--keep FOLDER] [--jobs N]`

The output is one line per run with the largest and the RMS true distance of the tip, then a table. NAME is `fig8`,
`fig10`, `ramps`, `quick`, `shaft` or `moving`; the prefix `LAB:` selects another lab than `realistic`. The option
`--set '{"load": "forces", "filter_bandwidth": 0.7}'` selects the controller without moments. `--keep` writes the rows
of each run (channels of joints, sensors and truth) to .npz files.
"""

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.job_pool import JobPool
from station.experiments.results import summarise
from station.experiments.runner import run_case

AT_ONCE = {"kind": "trapezoid", "magnitude": 0.3, "rise": 0.0, "fall": 0.0, "stay": 8.0, "start": 4.0}
SHAFT = {"kind": "contact", "magnitude": 0.5, "place": 0.10}
LAWS = {
    "default": {},
    "paper": {"inner": "type_1", "feedback": "tracker", "load": "forces", "filter_bandwidth": 1.0},
    "held": {"strategy": "unloaded_jacobian"},
}
#: Experiment, case, and changed keys of the runs of each name.
RUNS: dict[str, list[tuple[str, str, str, dict[str, Any]]]] = {
    "fig8": [("fig8", "fig8", "regulation", {})],
    "fig8_short": [("fig8_short", "fig8", "regulation", {"duration": 25.0})],
    "fig8_paper": [("fig8_paper", "fig8", "type_1", {})],
    "fig10": [("fig10", "fig10", "feedforward", {"duration": 60.0})],
    "fig10_paper": [("fig10_paper", "fig10", "paper", {"duration": 60.0})],
    "ramps": [(f"ramp_{t}s", "load_rate", f"regulation-ramp_{t}s", {}) for t in ("5", "2_5", "1_5", "1")],
    "ramps_paper": [(f"ramp_{t}s_paper", "load_rate", f"type_1-ramp_{t}s", {}) for t in ("5", "2_5", "1_5", "1")],
    "quick": [
        (t, "load_rate", f"regulation-{t}", {})
        for t in ("ramp_10s", "ramp_0_5s", "ramp_0_25s", "ramp_0_1s", "step", "rubber_band", "lift_and_drop", "tap")
    ],
    "shaft": [
        (f"shaft_{law}", "fig8", "regulation", {"duration": 12.0, "settling": 0.0, "load": SHAFT, "controller": change})
        for law, change in LAWS.items()
    ],
    "moving": [
        (
            f"moving_{law}", "fig10", "feedforward",
            {"duration": 20.0, "settling": 2.0, "load": AT_ONCE, "controller": change},
        )
        for law, change in LAWS.items()
    ],
}  # fmt: skip
KEPT = (
    "time", "joints", "wrench_raw", "force", "moment", "force_true", "tip_true", "tip_measured", "tip_estimated",
    "tip_desired", "tip_observed", "velocity_sent", "force_filtered", "bias", "tip_new", "observer_used",
)  # fmt: skip


def job(at: tuple[str, str, str, dict[str, Any], str, int, str], progress: Any) -> dict[str, Any]:
    """Run one case with one seed; return its errors."""
    name, experiment, case_name, changes, lab, seed, keep = at
    case = _case(experiment, case_name, changes | {"lab": lab})
    recording = run_case(case, seed, VirtualClock(), progress)
    found = summarise(recording)
    if keep:
        rows = recording.rows
        np.savez(
            f"{keep}/{lab}-{name}-{seed}.npz",
            **{group: recording.channels.of(rows, group) for group in KEPT if group in recording.channels.groups},
        )
    rms = float(np.linalg.norm(found.get("true_rms_error_mm", [np.nan])))
    return {
        "lab": lab, "run": name, "seed": seed, "completed": found["completed"], "cause": found["cause"],
        "largest_mm": found.get("true_max_distance_mm", np.nan), "rms_mm": round(rms, 4),
        "axis_mm": float(np.max(found.get("true_max_abs_error_mm", [np.nan]))),
        "force_N": found.get("force_rms_error_N"), "force_filtered_N": found.get("force_filtered_rms_error_N"),
        "wall_s": found["wall_s"],
    }  # fmt: skip


def _case(experiment: str, case_name: str, changes: dict[str, Any]) -> Case:
    return next(case for case in load_experiment(experiment, changes).cases if case.name == case_name)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="+")
    parser.add_argument("--seeds", type=int, nargs="+", default=[31, 32, 33, 34, 35, 36])
    parser.add_argument("--keep", default="")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--set", default="{}", help="keys of [controller] as JSON, for all runs")
    parsed = parser.parse_args()
    everything = json.loads(parsed.set)
    if parsed.keep:
        Path(parsed.keep).mkdir(parents=True, exist_ok=True)
    jobs = []
    for given in parsed.names:
        lab, _, name = given.rpartition(":")
        for each, experiment, case, changes in RUNS[name]:
            merged = changes | {"controller": {**changes.get("controller", {}), **everything}}
            merged = merged if merged["controller"] else changes
            jobs += [(each, experiment, case, merged, lab or "realistic", seed, parsed.keep) for seed in parsed.seeds]
    table: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)

    def kept(row: dict[str, Any]) -> bool:
        table[row["lab"], row["run"]].append(row)
        sys.stdout.write(f"{json.dumps(row)}\n")
        sys.stdout.flush()
        return True

    with JobPool(parsed.jobs) as started:
        started.carry_out(job, jobs, lambda parts: None, kept)
    for (lab, name), rows in table.items():
        line = f"{lab:10s} {name:22s}"
        for key in ("largest_mm", "axis_mm", "rms_mm"):
            values = [row[key] for row in rows]
            line += f"  {key} {np.median(values):.2f} / {np.max(values):.2f}"
        sys.stdout.write(f"{line}  n {len(rows)}\n")


if __name__ == "__main__":
    main()
