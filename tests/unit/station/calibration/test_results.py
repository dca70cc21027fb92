"""Stored calibrations are listed and read, with the instructions for using them."""

import json
import math
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from station.calibration.catalogue import start_procedure
from station.calibration.files import carry_over
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import PlanSubject
from station.calibration.results import NoResultError, Results, connection_checklist
from station.calibration.static_lab import StaticLab, run_static
from station.control.bench_calibration import BenchCalibration
from station.lab.config import load_lab

START = np.array([0.0, math.pi / 2, -0.100])
NUMBERS = {
    "procedure": "axes", "made": "2026-01-01T00:00:00+00:00", "lab": "a lab", "simulated": True, "findings": [],
    "found": [], "visits": 6, "robot_s": 30.0,
}  # fmt: skip


def keep(folder: Path, name: str, **numbers: object) -> Path:
    path = folder / name
    path.mkdir()
    (path / "report.json").write_text(json.dumps(NUMBERS | numbers), encoding="utf-8")
    return path


def test_calibrations_are_listed_newest_first_without_damaged_and_hidden_ones(tmp_path):
    edited = keep(tmp_path, "old", made="2026-01-01T00:00:00+00:00") / "report.json"
    edited.write_text(edited.read_text(), encoding="utf-16")
    keep(tmp_path, ".Trash-1000")
    keep(tmp_path, "new", made="2026-02-01T00:00:00+00:00")
    (keep(tmp_path, "cut") / "report.json").write_text('{"procedure": "ax')
    (keep(tmp_path, "other") / "report.json").write_text("[]")
    (tmp_path / "empty").mkdir()
    for number, spoilt in enumerate(
        ({"procedure": "magic"}, {"findings": 5}, {"found": [{"name": 1}]}, {"made": 2026})
    ):
        keep(tmp_path, f"spoilt {number}", **spoilt)
    (keep(tmp_path, "half") / "report.json").write_text(json.dumps(NUMBERS | {"lab": "\ud800"}))
    (keep(tmp_path, "deep") / "report.json").write_text("[" * 100_000)
    keep(tmp_path, os.fsdecode(b"copy\xff"))

    assert [kept.name for kept in Results(tmp_path).all()] == ["new", "old"]
    assert Results(tmp_path / "nowhere").all() == []


@pytest.mark.parametrize("name", ["nope", "..", "../secret", "/etc", ""])
def test_calibration_name_cannot_select_a_path_outside_the_folder(tmp_path, name):
    keep(tmp_path, "secret")
    results = tmp_path / "results"
    results.mkdir()
    keep(results, "one")

    with pytest.raises(NoResultError, match="not one of the calibrations"):
        Results(results).one(name)
    with pytest.raises(NoResultError, match="has no file"):
        Results(results).file("one", "../../secret/report.json")


def test_instructions_name_the_station_file_keys_of_signs(tmp_path):
    signs = {"outer_rotation": 1.0, "inner_rotation": -1.0}
    keep(tmp_path, "mirrored", signs=signs)
    keep(tmp_path, "right", signs=dict.fromkeys(signs, 1.0))
    keep(tmp_path, "straight", signs=signs | {"outer_rotation": 0.0, "inner_rotation": 1.0})

    use = {kept.name: kept.use for kept in Results(tmp_path).all()}

    assert "joints.inner_rotation.backwards" in use["mirrored"].text
    assert "outer_rotation" not in use["mirrored"].text
    assert "Nothing has to be changed" in use["right"].text
    assert "the direction of outer_rotation: check it" in use["straight"].text
    assert all(each.line == "" for each in use.values())


def test_instructions_of_a_calibration_give_a_valid_line_for_the_station_file(tmp_path):
    folder = tmp_path / 'a "new" one'
    folder.mkdir()
    (keep(folder, "tracker") / "registration.toml").write_text("")

    use = Results(folder).one("tracker").use

    assert tomllib.loads(use.line)["calibration"] == str(folder / "tracker")


def test_missing_files_of_a_new_calibration_are_copied_from_the_one_in_use(tmp_path, paper):
    """The folder of the newest calibration is then complete."""
    subject = PlanSubject.of(paper, START)
    bench = StaticLab(subject, load_lab("uncalibrated", paper), 3)
    first, second = tmp_path / "first", tmp_path / "second"
    write_all(first, run_static(start_procedure("tracker", subject, 0.5), bench), subject, provenance("tracker"))

    numbers = write_all(
        second, run_static(start_procedure("force", subject, 0.5), bench), subject, provenance("force"), known=first
    )

    assert numbers["files"] == ["sensors.toml", "registration.toml", "described.toml"]
    known = BenchCalibration.load(second, paper)
    assert known.folder == second
    assert known.corrections.sensors.mounting.shape == (2, 3, 3)
    earlier = BenchCalibration.load(first, paper).registration
    assert known.registration is not None
    assert earlier is not None
    np.testing.assert_array_equal(known.registration.position, earlier.position)
    assert carry_over(first, second) == []


def provenance(what: str) -> Provenance:
    return Provenance(what, "2026-01-01T00:00:00+00:00", "bench of 'paper': zaber, aurora, netft", None, 100.0, False)


def test_results_of_a_real_bench_are_not_marked_simulated(tmp_path, paper):
    subject = PlanSubject.of(paper, START)
    bench = StaticLab(subject, load_lab("uncalibrated", paper), 3)

    write_all(
        tmp_path / "one", run_static(start_procedure("tracker", subject, 0.5), bench), subject, provenance("tracker")
    )

    kept = Results(tmp_path).one("one")
    assert kept.numbers.simulated is False
    for name in kept.files:
        text = (tmp_path / "one" / name).read_text(encoding="utf-8")
        assert "simulated devices" not in text
        assert "seed" not in text or name == "report.json"


def procedures(before, now) -> list[str]:
    return [todo.procedure for todo in connection_checklist(before, now) if todo.procedure]


def test_reinserted_tubes_need_the_procedure_tracker(paper):
    assert procedures(paper, paper) == ["tracker"]


def test_tubes_of_another_stiffness_need_the_procedure_tubes(paper):
    stiffer = paper.tubes[0].model_copy(update={"bending_stiffness": 0.05})

    assert procedures(paper, paper.model_copy(update={"tubes": (stiffer, paper.tubes[1])})) == ["tubes"]


def test_changed_stages_need_the_procedures_axes_and_latency(paper):
    coarse = paper.joints[0].model_copy(update={"microstep": 1e-5})
    other = paper.model_copy(update={"joints": (coarse, *paper.joints[1:])})

    assert procedures(paper, other) == ["axes", "latency", "tracker"]


def test_manual_tasks_precede_procedures_in_the_checklist(paper):
    todo = connection_checklist(paper, paper)

    assert [bool(each.procedure) for each in todo] == sorted(bool(each.procedure) for each in todo)
    assert "power off" in todo[0].text
