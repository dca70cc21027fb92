"""The time of day is set by people and by the network, back and forth: it stamps what happens, and nothing waits by it.

Durations, leases, deadlines and rows go by a clock that only counts (`time.monotonic`, `station/control/clock.py`).
"""

import ast

from tests.harness.root import ROOT

#: Who may ask for it: names of folders, stamps of files, recordings, log lines and messages to others.
STAMPING = {
    "station/bench/report.py", "station/cli/calibrate.py", "station/cli/validate.py", "station/cli/workspace.py",
    "station/experiments/manifest.py", "station/experiments/output.py", "station/experiments/sweep_plan.py",
    "station/recording/run_folder.py", "station/recording/writer.py", "station/service/audit.py",
    "station/service/live_calibration.py", "station/service/runs.py",
    "web/gateway/foxglove/server.py", "web/gateway/igtl/server.py", "web/gateway/lsl.py",
    "web/gateway/ros2/publisher.py", "web/gateway/seen.py",
}  # fmt: skip
TIME_OF_DAY = {"time.time", "time.time_ns", "time_ns", "datetime.now", "datetime.today", "time.localtime"}


def asked() -> set[str]:
    """Files that ask for the time of day."""
    found: set[str] = set()
    for part in ("core", "station", "web"):
        for path in (ROOT / part).rglob("*.py"):
            calls = (one for one in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(one, ast.Call))
            if any(ast.unparse(call.func) in TIME_OF_DAY for call in calls):
                found.add(path.relative_to(ROOT).as_posix())
    return found


def test_the_time_of_day_is_asked_for_by_those_who_stamp_something_only():
    assert asked() == STAMPING
