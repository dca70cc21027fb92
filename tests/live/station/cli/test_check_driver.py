"""The command `check-driver` on simulated devices at real endpoints."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT


def check(*arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "station", "check-driver", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


@pytest.mark.parametrize("name", ["zaber", "zaber_ascii", "cia402", "grbl", "marlin", "aurora", "netft"])
def test_built_in_drivers_pass(name):
    done = check(name, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    driver = "gcode" if name in ("grbl", "marlin") else name
    assert done.stdout.splitlines()[0].endswith(f"driver {driver}")
    assert "FAIL" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either the name of a built-in driver, or a station file with --config"),
        (["nidaq"], "no simulated device has the driver 'nidaq'"),
        (["zaber", "--config", "a.toml"], "give either the name of a built-in driver, or a station file with --config"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    done = check(*arguments, cwd=ROOT)
    assert done.returncode == 2
    assert message in done.stderr


def test_station_file_without_devices_is_refused(tmp_path):
    (tmp_path / "a.toml").write_text('robot = "paper"\n', encoding="utf-8")
    done = check("--config", str(tmp_path / "a.toml"), cwd=ROOT)
    assert done.returncode == 2
    assert "it has no [devices]" in done.stderr
