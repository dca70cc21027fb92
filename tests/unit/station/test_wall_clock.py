"""The time of day may be set back or forward, so the station uses it only for time stamps and never for waiting.

Durations, leases, deadlines and rows use a monotonic clock (`time.monotonic`, `station/control/clock.py`).
"""

import ast

from tests.harness.root import ROOT

#: Files that may read the time of day: for names of folders, and time stamps of files, recordings and log lines.
STAMPING = {
    "station/camera/host.py", "station/camera/video.py", "station/cli/calibrate.py",
    "station/cli/cameras.py", "station/recording/deletion.py",
    "station/cli/validate.py", "station/cli/workspace.py",
    "station/experiments/output.py", "station/experiments/sweep_folder.py", "station/experiments/sweep_plan.py",
    "station/recording/history.py", "station/recording/run_folder.py", "station/recording/writer.py",
    "station/service/audit.py", "station/service/camera_calibration.py",
    "station/service/live_calibration.py", "station/service/runs.py",
    "web/access/audit_middleware.py", "web/api/cameras.py",
    "web/gateway/foxglove.py", "web/gateway/igtl.py", "web/gateway/lsl.py",
    "web/gateway/ros2.py", "web/gateway/snapshot.py",
}  # fmt: skip
TIME_OF_DAY = {"time.time", "time.time_ns", "time_ns", "datetime.now", "datetime.today", "time.localtime"}


def readers() -> set[str]:
    """Return the files that read the time of day."""
    found: set[str] = set()
    for part in ("core", "station", "web"):
        for path in (ROOT / part).rglob("*.py"):
            calls = (one for one in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(one, ast.Call))
            if any(ast.unparse(call.func) in TIME_OF_DAY for call in calls):
                found.add(path.relative_to(ROOT).as_posix())
    return found


def test_product_code_reads_the_time_of_day_only_for_time_stamps():
    assert readers() == STAMPING
