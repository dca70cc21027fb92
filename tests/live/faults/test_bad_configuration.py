"""An invalid station file ends `ctr-station serve` with one line of error, before any child process starts."""

import subprocess
import sys
import time

import psutil


def test_invalid_station_file_ends_serve_before_any_child_process_starts(write) -> None:
    path = write("[controller]\nstrategy = 'magic'\n")
    command = [sys.executable, "-c", "from web.cli import main; main()", "serve", "--config", str(path), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        watched = psutil.Process(process.pid)
        children = set()
        while process.poll() is None:
            time.sleep(0.02)
            children |= {child.pid for child in watched.children()} if watched.is_running() else set()
        said = process.stdout.read()

    assert process.returncode == 2
    assert said.strip().count("\n") == 0
    assert f"{path}: " in said
    assert "magic" in said
    assert children == set()
