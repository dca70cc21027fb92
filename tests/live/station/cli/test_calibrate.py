"""`ctr-station calibrate` as a separate process that receives Ctrl-C."""

import os
import signal
import subprocess
import sys
import time

from tests.harness.waiting import NET


def test_ctrl_c_ends_calibrate_and_leaves_no_files(tmp_path, environment):
    command = [sys.executable, "-m", "station", "calibrate", "tubes", "--realtime", "--out", "found"]
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        time.sleep(8.0)
        assert process.poll() is None, process.stderr.read()
        os.kill(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=NET)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert b"interrupted" in errors
    assert not (tmp_path / "found").exists()
