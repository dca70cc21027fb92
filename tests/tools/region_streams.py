"""Random streams of setpoints near meshes whose files have random faults.

`python -m tests.tools.region_streams [--runs 10] [--first 0] [--seconds 3]`

Each run has a mesh with a random fault at 1 to 5 mm from the outer half of the tubes in the start pose. A mesh that the
station accepts is used. Half of the refused ones are used as well, without the check, to represent faults that the
check does not find. A client streams a random setpoint within 8 mm, one 12 mm towards the mesh, and a random one. The
program prints the smallest clearance of the true tubes, less the margin of 1 mm, and the largest distances of
setpoint and true tip from the hull of what was sent. A run that begins inside the margin, because of the errors of
the model, retreats; it must not come nearer than at its start. The tip may leave this hull without any region, where
the robot cannot follow; therefore the same stream runs again without regions.
"""

import argparse

import numpy as np

from core.errors import DescriptionError
from core.model.backbone import backbone
from core.robot.closed_surface import closed_surface
from core.robot.keep_out import KeepOut
from core.robot.regions import Region, mesh
from core.robot.robot import Array
from tests.harness.streamed_tip import StreamRun, stream, with_limits
from tests.harness.true_clearance import START
from tests.harness.wrong_meshes import random_mesh

#: Faults whose shape has no meaning without the check, or which no controller could use.
UNUSABLE = ("nan", "infinite", "1e300", "1e-300", "1e-15", "far away", "micrometres", "metres")


def random_stream(seed: int, seconds: float, *, checked: bool = True) -> tuple[str, StreamRun, StreamRun] | None:
    """Return the fault of a random mesh and the runs with and without it; None if the mesh is not used.

    Args:
        seed: seed of mesh and setpoints.
        seconds: duration of the stream [s].
        checked: True: use only meshes that the station accepts, as it uses them. False: use the other ones as they are.
    """
    random = np.random.default_rng(seed)
    made = random_mesh(seed)
    try:
        triangles = closed_surface(made.triangles).mesh.triangles
    except DescriptionError:
        if checked or made.fault in UNUSABLE:
            return None
        triangles = made.triangles
    else:
        if not checked:
            return None
    statics = with_limits(()).statics
    near = backbone(statics, statics.solve(START, np.zeros(6)))
    for _ in range(100):  # until the mesh is near the tubes, and does not touch them
        direction: Array = random.normal(size=3)
        centre = near.points[int(random.integers(len(near.points) // 2, len(near.points)))] + random.uniform(
            0.003, 0.05
        ) * direction / np.linalg.norm(direction)
        placed = triangles - triangles.mean(axis=(0, 1)) + centre
        known = KeepOut(Region("mesh", "mesh", (), mesh=mesh(placed)))
        corners = np.linalg.norm(near.points[:, None] - placed.reshape(1, -1, 3), axis=2).min()
        distance = known.clearance(near).distance
        if 0.001 < abs(distance) < 0.005 and corners > 0.002 and (distance > 0.0 or not checked):
            break
    else:
        return None
    sent = [(seconds * number / 3, random.uniform(-0.008, 0.008, 3) / np.sqrt(3.0)) for number in range(3)]
    towards = placed.reshape(-1, 3)[np.linalg.norm(placed.reshape(-1, 3) - near.points[-1], axis=1).argmin()]
    towards = towards - near.points[-1]
    sent[1] = (sent[1][0], 0.012 * towards / np.linalg.norm(towards))  # the second setpoint is towards the mesh
    true = [known] if checked else []
    return made.fault, stream([known], true, sent, seconds, seed), stream([], true, sent, seconds, seed)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Stream random setpoints near random meshes.")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seconds", type=float, default=3.0, help="duration of a stream [s]")
    chosen = parser.parse_args()
    worst = {True: (np.inf, 0.0, 0), False: (np.inf, 0.0, 0)}
    for seed in range(chosen.first, chosen.first + chosen.runs):
        checked = seed % 3 > 0
        if (found := random_stream(seed, chosen.seconds, checked=checked)) is None:
            continue
        fault, run, free = found
        clearance, tip, count = worst[checked]
        worst[checked] = min(clearance, run.clearance - min(run.at_start, 0.0)), max(tip, run.tip - free.tip), count + 1
        print(  # noqa: T201
            f"{seed} {'accepted' if checked else 'unchecked'} {fault}: clearance {1e3 * run.clearance:.3f} (start"
            f" {1e3 * run.at_start:.3f}), setpoint"
            f" {1e3 * run.setpoint:.3f}, tip {1e3 * run.tip:.3f} mm {run.state.name} {run.cause}; without"
            f" region: clearance {1e3 * free.clearance:.3f}, tip {1e3 * free.tip:.3f} mm",
            flush=True,
        )
    for checked, (clearance, tip, count) in worst.items():
        kind = "accepted" if checked else "unchecked"
        print(  # noqa: T201
            f"{count} {kind}: at least {1e3 * clearance:.3f} mm from the margin, or from the start inside it; tip at"
            f" most {1e3 * tip:.3f} mm farther off than without region"
        )


if __name__ == "__main__":
    main()
