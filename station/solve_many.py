"""The model at many poses, on all processors: `core.model.many` with its chunks spread over threads."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

from core.model.many import CHUNK, Solutions
from core.model.many import solve_many as in_one_thread
from core.model.statics import Statics
from core.robot.robot import Array
from station.experiments.side_by_side import processors


def solve_many(
    models: Statics | Sequence[Statics],
    joints: Array,
    wrenches: Array,
    near: Solutions | None = None,
    along: bool = False,
    threads: int | None = None,
) -> Solutions:
    """As `core.model.many.solve_many`, with the same answers, on so many threads; None: one a processor."""
    chunks = -(-len(joints) // CHUNK)
    count = min(threads or processors(), chunks) if chunks > 1 else 1
    if count == 1:
        return in_one_thread(models, joints, wrenches, near, along)
    pool = ThreadPoolExecutor(count)

    def spread(solve: Callable[[int], None], firsts: Iterable[int]) -> Iterable[None]:
        return pool.map(solve, firsts)

    try:
        return in_one_thread(models, joints, wrenches, near, along, spread)
    finally:
        pool.shutdown(cancel_futures=True)  # Ctrl-C does not wait for the rest
