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


#: Program whose command receives Ctrl-C inside a destructor, where Python ignores exceptions.
LOST = """
import argparse, os, signal, time
from station.cli.main import execute
class Sender:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
def command(parsed):
    sender = Sender()
    del sender
    time.sleep(200.0)
    return 0
top = argparse.ArgumentParser()
top.set_defaults(command=command)
raise SystemExit(execute(top, [], []))
"""


def test_ctrl_c_inside_a_destructor_is_not_lost(environment):
    done = subprocess.run([sys.executable, "-c", LOST], env=environment, capture_output=True, timeout=NET)
    assert done.returncode == 130
    assert b"interrupted" in done.stderr
