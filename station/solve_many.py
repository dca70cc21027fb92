"""Solve the model at many poses on all processors: threads share the chunks of `core.model.batch`."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

from core.model.batch import CHUNK_ROWS, Solutions
from core.model.batch import solve_many as in_one_thread
from core.model.statics import Statics
from core.robot.robot import Array
from station.jobs.processes import processors


def solve_many(
    models: Statics | Sequence[Statics],
    joints: Array,
    wrenches: Array,
    near: Solutions | None = None,
    along: bool = False,
    threads: int | None = None,
) -> Solutions:
    """Return the solutions of `core.model.batch.solve_many`, computed by at most `threads` threads.

    If `threads` is None, there is one thread for each processor.
    """
    chunks = -(-len(joints) // CHUNK_ROWS)
    count = min(threads or processors(), chunks) if chunks > 1 else 1
    if count == 1:
        return in_one_thread(models, joints, wrenches, near, along)
    pool = ThreadPoolExecutor(count)

    def spread(solve: Callable[[int], None], firsts: Iterable[int]) -> Iterable[None]:
        return pool.map(solve, firsts)

    try:
        return in_one_thread(models, joints, wrenches, near, along, spread)
    finally:
        pool.shutdown(cancel_futures=True)  # Ctrl-C does not wait for the remaining chunks
