"""Random motions between obstacles or in a lumen.

`python -m tests.tools.keep_out_runs LAB [--kind lumen] [--runs 10] [--first 0] [--force 0.3] [--calibrated] [--time]`

With the kind `spheres` each run has three spheres at 2 to 8 mm from the model's tubes of the start pose and at least
2 mm from the true ones. With the kind `lumen` the tubes are inside a mesh of 2016 triangles around those of the start
pose, with a radius of 6 to 12 mm that changes along the axis. Each run has four random waypoints within 12 mm, and a
load of up to `--force` [N] in a random direction, which rises in 5 s. With `--calibrated` the bench of each seed is
first calibrated by itself. With `--time` each run is repeated with a controller that does not know the regions.

The program prints the smallest clearance of the true tubes, less the margin of 1 mm, and how many motions ended in
HOLD. The path is not checked before its start, so it may lead through a region: the tubes of the controller's model
then miss the margin if their tip is at the setpoint, or the setpoint has passed the region.
"""

import argparse
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from core.model.backbone import backbone
from core.robot.keep_out import KeepOut
from core.robot.robot import Array
from station.benchmarks.headless import timed_steps
from station.config.loads import RampLoad
from station.config.motions import WaypointsMotion
from station.config.regions import MeshRegion, RegionFile, SphereRegion, keep_out
from station.control.bench_calibration import BenchCalibration
from station.lab.config import load_lab
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import virtual_bench
from tests.harness.lumen_mesh import write_lumen
from tests.harness.true_clearance import CONTROLLER, ROBOT, START, run_between, true_clearance
from tests.tools.calibrated_runs import write

SPHERES, DURATION_S = 3, 16.0


def random_spheres(random: np.random.Generator, bench: SimulatedBench) -> list[SphereRegion]:
    """Return spheres near the tubes of the start pose, none of which touches them; `bench` has the true tubes there."""
    statics = CONTROLLER.controller(ROBOT).statics
    near = backbone(statics, statics.solve(START, np.zeros(6)))
    found: list[SphereRegion] = []
    while len(found) < SPHERES:
        direction: Array = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        radius, distance = random.uniform(0.003, 0.015), random.uniform(0.002, 0.008)
        centre = near.points[random.integers(12, 32)] + (radius + distance + 0.0022) * direction
        sphere = SphereRegion(name=f"sphere {len(found)}", centre=tuple(centre.tolist()), radius=radius)
        (limit,) = keep_out([sphere])
        assert isinstance(limit, KeepOut)
        if min(limit.clearance(near).distance, true_clearance(bench, [limit])) > 0.001:
            found.append(sphere)
    return found


def random_lumen(random: np.random.Generator, bench: SimulatedBench, folder: Path) -> list[MeshRegion]:
    """Return a mesh around the tubes of the start pose; `bench` has the true tubes there."""
    statics = CONTROLLER.controller(ROBOT).statics
    near = backbone(statics, statics.solve(START, np.zeros(6)))
    line = near.points[: near.along]
    ahead, behind = line[-1] - line[-2], line[0] - line[1]
    more = np.arange(1, 6)[:, None]
    axis = np.vstack((line[0] + more[::-1] * behind, line, line[-1] + more * ahead))
    while True:
        waves = sum(random.uniform(-1.0, 1.0) * np.sin(k * np.linspace(0.0, np.pi, len(axis))) for k in range(1, 4))
        file = folder / f"lumen{random.integers(1 << 40)}.stl"
        write_lumen(file, axis, np.clip(random.uniform(0.007, 0.011) + 0.002 * waves, 0.006, 0.012))
        region = MeshRegion(name="lumen", file=str(file), inside=True)
        (limit,) = keep_out([region])
        if min(limit.clearance(near).distance, true_clearance(bench, [limit])) > 0.001:
            return [region]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Run random motions between obstacles or in a lumen.")
    parser.add_argument("lab", choices=("gentle", "realistic"))
    parser.add_argument("--kind", choices=("spheres", "lumen"), default="spheres")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--force", type=float, default=0.3, help="largest load [N]")
    parser.add_argument("--calibrated", action="store_true", help="calibrate the bench of each seed first")
    parser.add_argument("--time", action="store_true", help="print the durations of the controller's steps, too")
    wanted = parser.parse_args()
    lab, smallest, stopped, through, folder = wanted.lab, np.inf, 0, 0, Path(tempfile.mkdtemp())
    for seed in range(wanted.first, wanted.first + wanted.runs):
        random = np.random.default_rng(seed)
        bench, _ = virtual_bench(ROBOT, load_lab(lab, ROBOT), seed, START)
        assert isinstance(bench, SimulatedBench)
        regions: Sequence[RegionFile] = (
            random_lumen(random, bench, folder) if wanted.kind == "lumen" else random_spheres(random, bench)
        )
        corners = [(4.0 * (number + 1), *random.uniform(-0.012, 0.012, 3).tolist()) for number in range(4)]
        motion = WaypointsMotion(points=((0.0, 0.0, 0.0, 0.0), *corners))
        direction = random.normal(size=3)
        load = RampLoad(
            direction=tuple(direction.tolist()), times=(1.0, 6.0), magnitudes=(0.0, random.uniform(0.0, wanted.force))
        )
        calibration = None
        if wanted.calibrated:
            own = folder / str(seed)
            own.mkdir()
            write(own, lab, seed)
            calibration = BenchCalibration.load(own, ROBOT)
        run = partial(run_between, regions, motion, DURATION_S, load, lab=lab, seed=seed, calibration=calibration)
        with timed_steps() as taken:
            found = run()
        if wanted.time:
            with timed_steps() as free:
                run(limited=False)
            print(f"{seed}: median of a step {1e6 * median(taken):.0f} us, without regions {1e6 * median(free):.0f} us")  # noqa: T201
        smallest, stopped = min(smallest, found.true), stopped + bool(found.cause)
        through += found.at_setpoint < 0.0 or found.cause.startswith("the path leads through the region")
        hold = f", at the setpoint {1e3 * found.at_setpoint:.2f} mm: {found.cause}" if found.cause else ""
        print(f"{seed}: true {1e3 * found.true:.3f}, recorded {1e3 * found.recorded:.3f} mm{hold}", flush=True)  # noqa: T201
    ended = f"{stopped} ended in HOLD, {through} on a path through a region"
    print(f"smallest of {wanted.runs}: {1e3 * smallest:.3f} mm; {ended}")  # noqa: T201


if __name__ == "__main__":
    main()
