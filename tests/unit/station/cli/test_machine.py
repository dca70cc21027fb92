"""Files for the setup of a bench computer, and checks of their installation."""

import getpass
import shutil
import subprocess
from pathlib import Path

import pytest

from station.cli.machine import MACHINE_FILES, MACHINE_FOLDER, machine_file, rights, rules, service


@pytest.mark.parametrize("word", MACHINE_FILES)
def test_printed_setup_file_has_no_placeholders(word: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("SUDO_USER", raising=False)
    text = machine_file(word)
    assert text.endswith("\n")
    assert "@user@" not in text
    assert "@command@" not in text
    assert (f"User={getpass.getuser()}\n" in text) == (word == "service")


def test_user_of_the_service_is_the_caller_of_sudo(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SUDO_USER", "zoe")
    assert "User=zoe\n" in machine_file("service")


def test_doctor_can_print_every_file_of_the_machine_folder():
    assert {path.name for path in MACHINE_FOLDER.iterdir()} == {*MACHINE_FILES.values(), "README.md"}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_service_file_is_accepted_by_systemd(tmp_path: Path):
    unit = tmp_path / "ctr-station.service"
    lines = [line for line in machine_file("service").splitlines() if not line.startswith("ExecStart=")]
    unit.write_text("\n".join([*lines, "[Service]", "ExecStart=/bin/true"]), encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=60.0)
    assert [line for line in done.stderr.splitlines() if "ctr-station.service" in line] == []


def an_adapter(adapters: Path, latency: int) -> None:
    (adapters / "ttyUSB0").mkdir(parents=True)
    (adapters / "ttyUSB0" / "latency_timer").write_text(f"{latency}\n")


def test_missing_udev_rules_are_reported_if_there_are_adapters(tmp_path: Path):
    folder, adapters = tmp_path / "rules.d", tmp_path / "devices"
    assert rules([folder], adapters).good  # without adapters no rules are needed
    an_adapter(adapters, latency=1)
    missed = rules([folder], adapters)
    assert not missed.good
    assert "doctor --print rules" in missed.text


def test_inactive_or_outdated_udev_rules_are_reported(tmp_path: Path):
    folder, adapters = tmp_path / "rules.d", tmp_path / "devices"
    folder.mkdir()
    installed = folder / MACHINE_FILES["rules"]
    installed.write_text(machine_file("rules"))
    an_adapter(adapters, latency=16)
    late = rules([folder], adapters)
    assert (late.good, "ttyUSB0" in late.text, "plug it in again" in late.text) == (False, True, True)
    (adapters / "ttyUSB0" / "latency_timer").write_text("1\n")
    assert rules([folder], adapters).good
    installed.write_text("# older\n")
    assert not rules([folder], adapters).good


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("[Service]\n", "has no ExecStart"),
        ("ExecStart=/nowhere/ctr-station serve\n", "/nowhere/ctr-station, which does not exist"),
        ("ExecStart=/bin/true serve\nLimitRTPRIO=10\n", "no real-time scheduling"),
        ("ExecStart=/bin/true serve\nLimitRTPRIO=90\n", ""),
    ],
)
def test_doctor_checks_the_installed_service_file(tmp_path: Path, content: str, problem: str):
    unit = tmp_path / "ctr-station.service"
    assert service(unit).good  # without a service file there is nothing to check
    unit.write_text(content)
    found = service(unit)
    assert found.good == (problem == "")
    assert problem in found.text


def test_doctor_reports_a_serial_port_that_cannot_be_opened(tmp_path: Path):
    there = tmp_path / "ttyUSB0"
    there.touch()
    assert rights([str(there)]).good
    closed = rights([str(there), str(tmp_path / "ttyUSB1")])
    assert not closed.good
    assert "no access to" in closed.text
    assert "usermod -aG dialout" in closed.text
