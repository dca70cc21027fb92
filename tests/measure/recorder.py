"""`python -m tests.measure recorder`: processor time that the recording of a telemetry row needs.

In virtual time the control loop itself records the rows. In live operation a separate process records them. This
process is measured while it reads a telemetry ring to which 500 rows a second are written.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.control.clock import VirtualClock
from station.control.ring import Ring
from station.control.telemetry import Channels
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import run_case
from station.recording.read import open_case
from station.recording.recorder import LIVE_CASE, Recorder
from station.recording.run_outcome import RunOutcome
from station.recording.writer import CaseRecorder, CaseWriter

#: Duration of the run whose rows are recorded repeatedly [s].
RECORDED_SPAN_S = 4.0


def recorder(seconds: float) -> dict[str, Any]:
    """Record rows of `fig10` in both modes, live for `seconds`; return the processor time for a row [us]."""
    case = next(case for case in load_experiment("fig10").cases if case.name == "feedforward")
    case = case._replace(file=case.file.model_copy(update={"duration": RECORDED_SPAN_S}))
    run = run_case(case, 0, VirtualClock(), lambda _: None)
    with tempfile.TemporaryDirectory() as folder:
        in_loop, size = _in_loop(case, run.rows, Path(folder))
        live = _live(case, run.rows, seconds, Path(folder))
    return {
        "channels": run.rows.shape[1],
        "in_loop_us": round(in_loop, 2),
        "live": live,
        "bytes_per_row": round(size / len(run.rows)),
    }


def _in_loop(case: Case, rows: Array, folder: Path) -> tuple[float, int]:
    """Return the median time for a row over several recordings [us], and the size of the last recording [bytes]."""
    channels = Channels(case.robot.robot())
    taken: list[float] = []
    size = 0
    for number in range(7):
        writer = CaseWriter(folder / f"{number}.mcap", case.robot.robot(), channels.all, {})
        recorder = CaseRecorder(writer, len(channels))
        start = time.process_time()
        for row in rows:
            recorder.write(row)
        taken.append(1e6 * (time.process_time() - start) / len(rows))
        recorder.close(RunOutcome.COMPLETE)
        size = writer.path.stat().st_size
    # The first recording also loads the code of the model, so it is not counted.
    return float(np.median(taken[1:])), size


def _live(case: Case, rows: Array, seconds: float, folder: Path) -> dict[str, Any]:
    ring = Ring(rows.shape[1])
    process = Recorder(ring, case.robot, folder)
    try:
        process.begin("live", {})
        start, row = time.perf_counter(), rows[0].copy()
        for number in range(int(seconds / PERIOD_S)):
            time.sleep(max(0.0, start + number * PERIOD_S - time.perf_counter()))
            row[:] = rows[number % len(rows)]
            row[0] = number * PERIOD_S
            ring.write(row)
        path = process.end(RunOutcome.COMPLETE)
    finally:
        process.close()
        ring.close(remove=True)
    with open_case(path / f"{LIVE_CASE}.mcap") as recorded:
        took = float(recorded.result["cpu_s"])
        return {
            "us": round(1e6 * took / recorded.ticks, 2),
            "rows": recorded.ticks,
            "missed": recorded.result["missed"],
        }
