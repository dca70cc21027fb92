"""Fuzzes both sides of a protocol of stages: `python -m tests.fuzz.stages KIND CASES SEED`.

The driver runs on simulated devices while bytes of both directions are damaged, inserted or lost. It must raise
nothing, and a position that it reports as known must be true.
"""

import random
import sys
from typing import cast

import numpy as np

from station.config.robots import load_robot
from station.devices.interfaces import Condition
from station.lab.config import StagesKind
from station.lab.simulated_zaber import Faults
from tests.harness.stages_bench import StagesBench, swing

#: Largest position error that the estimate may have between two readings, if a velocity is lost [rad, rad, m].
TOLERANCE = np.array([0.05, 0.05, 0.003])


def fuzz(kind: StagesKind, cases: int, seed: int) -> dict[str, int]:
    """Run `cases` of 0.3 s with damaged bytes, each followed by a recovery; return the counts.

    `damaged` counts the bytes that were lost, changed or inserted in both directions.
    """
    source, robot = random.Random(seed), load_robot("paper")
    result = {"cases": 0, "damaged": 0, "exceptions": 0, "hangs": 0, "false_accepts": 0}
    bench = StagesBench(robot, kind, seed=seed).connect()
    for case in range(cases):
        result["cases"] += 1
        try:
            bench.simulated.faults = Faults(flip=10 ** source.uniform(-4, -1), drop=10 ** source.uniform(-4, -1))
            for _ in range(5):
                bench.run(0.06, swing)
                to_host, to_device = source.randbytes(source.randrange(40)), source.randbytes(source.randrange(40))
                bench.host.device.to_host.extend(to_host)
                bench.simulated.receive(to_device, bench.now)
                result["damaged"] += len(to_host) + len(to_device)
                wrong = np.abs(bench.reading.positions - bench.truth) > TOLERANCE
                result["false_accepts"] += bool(bench.stages.ready and wrong.any())
            bench.simulated.faults = Faults()
            result["damaged"] += bench.simulated.noise.damaged
            bench.simulated.noise.damaged = 0
            bench.run(0.3)
            bench.connect()
            result["hangs"] += bench.stages.condition is not Condition.CONNECTED
            if not bench.stages.ready:  # a lost stage must be homed again
                bench = StagesBench(robot, kind, seed=seed + case).connect()
        except Exception as error:  # any exception is a finding of the fuzzer
            sys.stderr.write(f"case {case} of seed {seed}: {error!r}\n")
            result["exceptions"] += 1
            bench = StagesBench(robot, kind, seed=seed + case).connect()
    return result


if __name__ == "__main__":
    kind, cases, seed = sys.argv[1:4]
    sys.stdout.write(f"{fuzz(cast(StagesKind, kind), int(cases), int(seed))}\n")
