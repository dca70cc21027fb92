"""What a bench's computer needs is printed for this installation, and looked for on it."""

import getpass
import shutil
import subprocess
from pathlib import Path

import pytest

from station.cli.machine import FILES, FOLDER, printed, rights, rules, service


@pytest.mark.parametrize("word", FILES)
def test_every_file_is_printed_and_made_out(word: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("SUDO_USER", raising=False)
    text = printed(word)
    assert text.endswith("\n")
    assert "@user@" not in text
    assert "@command@" not in text
    assert (f"User={getpass.getuser()}\n" in text) == (word == "service")


def test_whoever_asks_by_sudo_is_the_services_user(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SUDO_USER", "zoe")
    assert "User=zoe\n" in printed("service")


def test_every_file_of_the_folder_can_be_printed():
    assert {path.name for path in FOLDER.iterdir()} == {*FILES.values(), "README.md"}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_service(tmp_path: Path):
    unit = tmp_path / "ctr-station.service"
    lines = [line for line in printed("service").splitlines() if not line.startswith("ExecStart=")]
    unit.write_text("\n".join([*lines, "[Service]", "ExecStart=/bin/true"]), encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=60.0)
    assert [line for line in done.stderr.splitlines() if "ctr-station.service" in line] == []


def an_adapter(adapters: Path, latency: int) -> None:
    (adapters / "ttyUSB0").mkdir(parents=True)
    (adapters / "ttyUSB0" / "latency_timer").write_text(f"{latency}\n")


def test_rules_are_missed_where_there_are_adapters(tmp_path: Path):
    folder, adapters = tmp_path / "rules.d", tmp_path / "devices"
    assert rules([folder], adapters).good  # neither rules nor adapters
    an_adapter(adapters, latency=1)
    missed = rules([folder], adapters)
    assert not missed.good
    assert "doctor --print rules" in missed.text


def test_rules_that_are_not_heeded_or_not_of_this_version_are_told(tmp_path: Path):
    folder, adapters = tmp_path / "rules.d", tmp_path / "devices"
    folder.mkdir()
    installed = folder / FILES["rules"]
    installed.write_text(printed("rules"))
    an_adapter(adapters, latency=16)
    late = rules([folder], adapters)
    assert (late.good, "ttyUSB0" in late.text, "plug it in again" in late.text) == (False, True, True)
    (adapters / "ttyUSB0" / "latency_timer").write_text("1\n")
    assert rules([folder], adapters).good
    installed.write_text("# older\n")
    assert not rules([folder], adapters).good


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("[Service]\n", "starts nothing"),
        ("ExecStart=/nowhere/ctr-station serve\n", "/nowhere/ctr-station, which is not there"),
        ("ExecStart=/bin/true serve\nLimitRTPRIO=10\n", "no real-time scheduling"),
        ("ExecStart=/bin/true serve\nLimitRTPRIO=90\n", ""),
    ],
)
def test_a_service_is_looked_at(tmp_path: Path, said: str, told: str):
    unit = tmp_path / "ctr-station.service"
    assert service(unit).good  # none
    unit.write_text(said)
    found = service(unit)
    assert found.good == (told == "")
    assert told in found.text


def test_a_port_that_is_not_there_to_be_opened_is_told(tmp_path: Path):
    there = tmp_path / "ttyUSB0"
    there.touch()
    assert rights([str(there)]).good
    closed = rights([str(there), str(tmp_path / "ttyUSB1")])
    assert not closed.good
    assert "ttyUSB1 may not be opened" in closed.text
    assert "usermod -aG dialout" in closed.text
