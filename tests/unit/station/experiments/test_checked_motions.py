"""Checked motions in the user's cache: used while the package is unchanged, otherwise without effect."""

import json
from pathlib import Path

import pytest

import core
from station.experiments import checked_motions
from station.experiments.experiment import load_experiment


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the path of a cache that does not exist yet."""
    monkeypatch.setattr(checked_motions, "FILE", path := tmp_path / "cache" / "checked-motions.json")
    return path


def warnings() -> set[str]:
    return {text for case in load_experiment("fig3").cases for text in case.warnings}


def changed(file: Path, **parts: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | parts))


def warned(file: Path) -> set[str]:
    """Give all motions in the cache a warning that no check returns; return their keys."""
    keys = set(json.loads(file.read_text())["motions"])
    changed(file, motions={key: ["warning of an earlier check"] for key in keys})
    return keys


def test_motion_that_was_checked_before_is_read_from_the_cache(file: Path) -> None:
    assert warnings() == set()
    keys = warned(file)
    assert warnings() == {"warning of an earlier check"}
    load_experiment("demo")
    assert json.loads(file.read_text())["motions"].keys() > keys  # the others are kept


@pytest.mark.parametrize("damage", ["another version", "half", "no file", "folder"])
def test_cache_without_use_costs_only_another_check(file: Path, damage: str) -> None:
    warnings()
    warned(file)
    if damage == "another version":
        changed(file, fingerprint="another")
    elif damage == "half":
        file.write_text(file.read_text()[:50])
    else:
        file.unlink()
        if damage == "folder":
            file.mkdir()  # it can be neither read nor replaced
    assert warnings() == set()


def test_compiled_code_is_no_change_of_the_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "core" / "__pycache__").mkdir(parents=True)
    (tmp_path / "core" / "model.py").write_text("")
    monkeypatch.setattr(core, "__path__", [str(tmp_path / "core")])
    fingerprint = checked_motions._fingerprint.__wrapped__
    before = fingerprint()
    (tmp_path / "core" / "__pycache__" / "model.nbi").write_text("compiled")
    assert fingerprint() == before
    (tmp_path / "core" / "model.py").write_text("pass")
    assert fingerprint() != before


def test_user_without_a_home_folder_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checked_motions, "FILE", None)
    assert warnings() == set()
    assert checked_motions.read() == {}


def test_experiment_with_changes_is_checked_without_the_cache(file: Path) -> None:
    load_experiment("fig3", {"duration": 5.0})
    assert not file.exists()
