"""The command `calibrate`: calibrate a rig and write files that a run or a station can use."""

import argparse
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.cli.options import add_results, number_between, print_result, progress_bar, result_folder, seed
from station.cli.validate import add_columns

if TYPE_CHECKING:
    from core.robot.robot import Array
    from station.config.robots import RobotFile

PROCEDURES = {
    "axes": "direction of each axis, and coarse zero angles of the tubes",
    "latency": "delay of the tracker",
    "tracker": "poses of tracker and coil",
    "force": "orientation of the base sensors, weight mounted on them, drift",
    "tubes": "stiffness, curvature, Poisson's ratio, lengths and zeros of the tubes, and all frames and sensors",
    "residual": "tubes, and a learned correction of the model's remaining error by joints, last motions and load",
}


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `calibrate` to the parser."""
    calibrate = commands.add_parser(
        "calibrate", help="measure the poses of tracker, coil and sensors and the parameters of the tubes",
        epilog="; ".join(f"{name}: {about}" for name, about in PROCEDURES.items()),
    )  # fmt: skip
    calibrate.add_argument("what", choices=tuple(PROCEDURES))
    calibrate.add_argument(
        "--robot", default="paper", metavar="FILE", help="robot: preset or .toml file (default: paper)"
    )
    calibrate.add_argument(
        "--lab", default="uncalibrated", metavar="LAB", help="virtual lab: preset or .toml file (default: uncalibrated)"
    )
    calibrate.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of all random numbers of the lab (default: 0)"
    )
    calibrate.add_argument(
        "--effort",
        type=number_between(0.5, 5.0, "a factor", ""),
        default=1.0,
        metavar="X",
        help="factor on the number of poses, 0.5 ... 5 (default: 1)",
    )
    calibrate.add_argument(
        "--weights", nargs="+", type=number_between(0.02, 2.0, "a weight", "N"), default=(), metavar="N",
        help="known weights at the tip [N], 0.02 ... 2 (default: 0.25 0.5, less if the robot bears less)",
    )  # fmt: skip
    source = calibrate.add_mutually_exclusive_group()
    source.add_argument("--visit", action="store_true", help="visit poses on the rig (default)")
    source.add_argument(
        "--from", type=Path, dest="poses", metavar="POSES.csv",
        help="tubes, residual: use poses that were measured elsewhere, columns as in validate --help; nothing moves",
    )  # fmt: skip
    add_columns(calibrate)
    calibrate.add_argument(
        "--hysteresis",
        action="store_true",
        help="with --from: fit a lag of each joint that depends on its direction of travel",
    )
    calibrate.add_argument(
        "--still", action="store_true", help="measure each pose directly, without simulating the motion or the devices"
    )
    calibrate.add_argument(
        "--calibration", type=Path, metavar="DIR",
        help="folder of an earlier calibration: its cameras measure the tip, and its other files are copied",
    )  # fmt: skip
    calibrate.add_argument("--realtime", action="store_true", help="run in real time")
    add_results(calibrate, "calibrations")
    calibrate.set_defaults(command=_calibrate)


def _calibrate(parsed: argparse.Namespace) -> int:
    parsed.out = result_folder(parsed, "calibrations")
    if parsed.poses is not None or parsed.hysteresis:
        return _from_poses(parsed)
    from station.calibration.files import new_folder
    from station.calibration.outcome import Provenance, result_table, write_all
    from station.calibration.plan import PlanSubject
    from station.calibration.procedure import StoppedByHandError
    from station.config.robots import WHOLE_LOAD, load_robot
    from station.config.strict import ConfigError
    from station.control.bench_calibration import BenchCalibration
    from station.lab.aurora_coil import assumed_mounting
    from station.lab.config import load_lab

    robot = load_robot(parsed.robot)
    lab = load_lab(parsed.lab, robot)
    robot = robot.sensed_at(lab.sensors.at, "sensors.at of the lab")
    if lab.sensors.at not in WHOLE_LOAD and parsed.what == "force":
        raise ConfigError(
            f"lab '{parsed.lab}': sensors.at = '{lab.sensors.at}' cannot be calibrated; use tubes or robot"
        )
    subject = PlanSubject.of(robot, robot_start(robot), senses=lab.sensors.at in WHOLE_LOAD)
    views = {} if parsed.calibration is None else BenchCalibration.load(parsed.calibration, robot).views
    start_time = time.perf_counter()
    try:
        result, robot_s = _run_procedure(parsed, subject, lab, views)
    except StoppedByHandError as error:
        sys.stderr.write(f"ctr-station: {error}\n")
        return 130
    stamp = datetime.now().astimezone()
    folder = new_folder(parsed.out, f"{parsed.what}-seed{parsed.seed}-{stamp:%Y%m%d-%H%M%S}")
    provenance = Provenance(parsed.what, stamp.isoformat(timespec="seconds"), lab.title, parsed.seed, robot_s, True)
    summary = write_all(folder, result, subject, provenance, assumed_mounting(lab), parsed.calibration)
    summary["wall_s"] = round(time.perf_counter() - start_time, 3)
    took = f"{robot_s:.0f} s simulated in {summary['wall_s']:.1f} s"
    table = result_table(result, subject, provenance)
    return print_result(parsed, summary, [table], [*summary["findings"], took], folder)


def _from_poses(parsed: argparse.Namespace) -> int:
    from station.calibration.validation_output import write_calibration
    from station.cli.validate import run_validation
    from station.config.strict import ConfigError

    if parsed.poses is None:
        raise ConfigError("--hysteresis requires --from POSES.csv: a calibration on a rig always fits the drives' play")
    if parsed.what not in ("tubes", "residual"):
        raise ConfigError(
            f"--from works with 'calibrate tubes' and 'calibrate residual', not with 'calibrate {parsed.what}'"
        )
    parsed.test = None
    return run_validation(parsed, parsed.what, parsed.robot, parsed.what, write_calibration)


def _run_procedure(parsed: argparse.Namespace, subject: Any, lab: Any, views: Any) -> tuple[Any, float]:
    """Run a calibration procedure; return its result, and the time that it takes on a rig [s]."""
    from station.calibration import headless, static_lab
    from station.calibration.catalogue import start_procedure
    from station.control.clock import RealClock, VirtualClock

    procedure = start_procedure(parsed.what, subject, parsed.effort, tuple(parsed.weights))
    with progress_bar() as bar:
        task = bar.add_task(f"calibrate {parsed.what}", total=1.0)

        def progress(done: float, text: str) -> None:
            bar.update(task, completed=done)
            if text:
                bar.console.print(f"instruction for the operator: {text} (done by the virtual lab)", markup=False)

        if parsed.still:
            bench = static_lab.StaticLab(subject, lab, parsed.seed)
            return static_lab.run_static(procedure, bench, progress), bench.time
        clock = RealClock() if parsed.realtime else VirtualClock()
        result = headless.run_headless(procedure, subject, lab, parsed.seed, clock, progress, views=views)
        # The procedure `latency` is one swing of the joints; all others are series of measurements.
        return result, result.time if parsed.what == "latency" else result.measurements[-1].time


def robot_start(robot: "RobotFile") -> "Array":
    """Return the start pose of a calibration (n,): the working pose, or the middle of each travel [rad or m].

    Raises:
        ConfigError: there is no working pose, and the middle of the travel is not a valid pose.
    """
    import numpy as np

    from core.control.reachability import check_pose
    from core.errors import CtrError
    from core.model.statics import Statics
    from station.config.robots import named_pose
    from station.config.strict import ConfigError

    if robot.working_pose is not None:
        return named_pose(robot.working_pose, robot, "working_pose")
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
    try:
        check_pose(Statics(robot.robot()), robot.limits(), middle)
    except CtrError as error:
        raise ConfigError(
            f"robot '{robot.name}' has no working_pose, and the middle of its travel is not a valid pose"
            f" ({error}): add a working_pose to its file"
        ) from None
    return middle
