"""The command `calibrate`: finds out about a bench, and writes what a run or a station can be told."""

import argparse
import json
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import between, progress_bar, results_of, seed, tell

if TYPE_CHECKING:
    from core.robot.robot import Array
    from station.config.robots import RobotFile

PROCEDURES = {
    "axes": "which way each axis runs, and the tubes' zero angles roughly",
    "latency": "how late the tracker is",
    "tracker": "where tracker and coil are",
    "force": "how the base sensors stand, what hangs on them, how they drift",
    "tubes": "EI, curvature, nu, lengths and zeros of the tubes together with all frames and sensors",
}


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    calibrate = commands.add_parser(
        "calibrate", help="find out where tracker, coil and sensors are and how the tubes really are",
        epilog="; ".join(f"{name}: {about}" for name, about in PROCEDURES.items()),
    )  # fmt: skip
    calibrate.add_argument("what", choices=tuple(PROCEDURES))
    calibrate.add_argument("--robot", default="paper", metavar="FILE", help="preset or .toml file (paper)")
    calibrate.add_argument("--lab", default="uncalibrated", metavar="LAB", help="preset or .toml file (uncalibrated)")
    calibrate.add_argument("--seed", type=seed, default=0, metavar="N", help="of everything random in the lab (0)")
    calibrate.add_argument(
        "--effort", type=between(0.5, 5.0, "a factor", ""), default=1.0, metavar="X", help="more or fewer poses (1)"
    )
    calibrate.add_argument(
        "--from", type=Path, dest="poses", metavar="POSES.csv",
        help="tubes: of poses that were measured elsewhere, columns as in validate --help; nothing is moved",
    )  # fmt: skip
    calibrate.add_argument(
        "--hysteresis", action="store_true", help="with --from: each joint may lag behind the way that it came"
    )
    calibrate.add_argument(
        "--still", action="store_true", help="leave the ways between the poses out: averages at once, no wires"
    )
    calibrate.add_argument("--realtime", action="store_true", help="at the pace of the clock")
    calibrate.add_argument(
        "--out", type=Path, metavar="DIR", help="where results go (calibrations, in the folder of data if one is given)"
    )
    calibrate.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    calibrate.set_defaults(command=_calibrate)


def _calibrate(parsed: argparse.Namespace) -> int:
    parsed.out = results_of(parsed, "calibrations")
    if parsed.poses is not None or parsed.hysteresis:
        return _from_poses(parsed)
    from station.calibration.folder import new_folder
    from station.calibration.outcome import Provenance, write_all
    from station.calibration.plan import Subject
    from station.calibration.procedure import StoppedByHandError
    from station.config.robots import load_robot
    from station.lab.config import load_lab

    robot = load_robot(parsed.robot)
    lab = load_lab(parsed.lab, robot)
    subject = Subject.of(robot, robot_start(robot))
    begin = time.perf_counter()
    try:
        result, simulated = _carried_out(parsed, subject, lab)
    except StoppedByHandError as error:
        sys.stderr.write(f"ctr-station: {error}\n")
        return 130
    stamp = datetime.now().astimezone()
    folder = new_folder(parsed.out, f"{parsed.what}-seed{parsed.seed}-{stamp:%Y%m%d-%H%M%S}")
    provenance = Provenance(parsed.what, stamp.isoformat(timespec="seconds"), lab.title, parsed.seed, simulated)
    summary = write_all(folder, result, subject, provenance)
    summary["wall_s"] = round(time.perf_counter() - begin, 3)
    if parsed.json:
        sys.stdout.write(f"{json.dumps(summary)}\n")
    else:
        from station.calibration.outcome import result_table

        took = f"{simulated:.0f} s simulated in {summary['wall_s']:.1f} s"
        tell([result_table(result, subject, provenance)], [*summary["findings"], took], folder)
    return 0


def _from_poses(parsed: argparse.Namespace) -> int:
    from station.calibration.validation_output import write_calibration
    from station.cli.validate import held
    from station.config.strict import ConfigError

    if parsed.poses is None:
        raise ConfigError("--hysteresis goes with --from POSES.csv: at a bench the drives' play is always found")
    if parsed.what != "tubes":
        raise ConfigError(f"--from goes with 'calibrate tubes', not with 'calibrate {parsed.what}'")
    parsed.test = None
    return held(parsed, "tubes", parsed.robot, "tubes", write_calibration)


def _carried_out(parsed: argparse.Namespace, subject: Any, lab: Any) -> tuple[Any, float]:
    """The result, and how long it would have taken on a bench [s]."""
    from station.calibration import headless, static_lab
    from station.calibration.catalogue import begin
    from station.control.clock import RealClock, VirtualClock

    procedure = begin(parsed.what, subject, parsed.effort)
    with progress_bar() as bar:
        task = bar.add_task(f"calibrate {parsed.what}", total=1.0)

        def progress(done: float, text: str) -> None:
            bar.update(task, completed=done)
            if text:
                bar.console.print(f"a person is asked: {text} (done by the lab)", markup=False)

        if parsed.still:
            bench = static_lab.StaticLab(subject, lab, parsed.seed)
            return static_lab.carry_out(procedure, bench, progress), bench.time
        clock = RealClock() if parsed.realtime else VirtualClock()
        result = headless.carry_out(procedure, subject, lab, parsed.seed, clock, progress)
        # A latency is of one swing, everything else of measurements.
        return result, result.time if parsed.what == "latency" else result.measurements[-1].time


def robot_start(robot: "RobotFile") -> "Array":
    """Where a robot rests before it is calibrated (n,): its working pose, or the middle of each travel [rad or m].

    Raises:
        ConfigError: it has no working pose, and cannot stand in the middle of its travel.
    """
    import numpy as np

    from core.errors import CtrError
    from station.config.robots import named_pose
    from station.config.strict import ConfigError

    if robot.working_pose is not None:
        return named_pose(robot.working_pose, robot, "working_pose")
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
    try:
        robot.limits().check(middle)
        robot.robot().check_pose(middle)
    except CtrError as error:
        raise ConfigError(
            f"robot '{robot.name}' has no working_pose to begin at, and cannot stand in the middle of its travel"
            f" ({error}): add one to its file"
        ) from None
    return middle
