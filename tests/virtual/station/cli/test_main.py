"""The command line: its output, its files on disk and its exit status."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from station.recording.read import read_case

GOOD = b'{"joints": {"outer_rotation": 0, "inner_rotation": 1.57, "inner_translation": -0.1}, "force": [0.2, 0, 0]}\n'
TWO_CASES = "[cases.one]\n[cases.two.controller]\nfeedforward = true\n[paper.one]\nmax_abs_error_mm = { x = 7.9 }\n"


def folders(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir()) if out.exists() else []


def test_another_seed_changes_the_rows_of_a_run(call, write, short, tmp_path):
    for seed in ("1", "2"):
        assert call("run", str(write(short)), "--jobs", "1", "--seed", seed, "--out", "out").status == 0
    first, other = (read_case(path).rows for path in (tmp_path / "out").glob("*/own.mcap"))
    assert not (first == other).all()


def test_result_table_of_run_has_units_and_the_numbers_of_the_paper(call, write, short):
    done = call("run", str(write(short + TWO_CASES)), "--jobs", "1")

    assert done.status == 0
    measured = [line for line in done.out.splitlines() if "max |E| measured, from" in line]
    assert len(measured) == 2
    assert "one" in measured[0]
    assert "x 7.9" in measured[0]
    assert "two" in measured[1]
    assert "times real time" in done.out
    assert str(Path("runs") / "own-seed0-") in done.out


def test_run_of_one_case_with_another_value_runs_only_this_case_with_this_value(call, write, short, tmp_path):
    path = str(write(short + TWO_CASES))
    changes = ("--case", "two", "--set", "controller.feedforward=false")
    done = call("run", path, *changes, "--jobs", "1", "--json", "--out", "out")

    assert done.status == 0
    assert list(json.loads(done.out)["cases"]) == ["two"]
    (recording,) = (tmp_path / "out").glob("*/two.mcap")
    assert read_case(recording).metadata["settings"]["controller"]["feedforward"] is False


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--case", "three"), "--case three: the cases are one, two"),
        (("--set", "controller.k1=1,2"), "--set KEY=A,B gives several values, but 'run' uses one"),
        (("--set", "controller.k9=1"), "k9"),
    ],
)
def test_run_refuses_an_unknown_case_key_or_several_values(call, write, short, options, said):
    done = call("run", str(write(short + TWO_CASES)), *options)

    assert done.status == 2
    assert said in done.err


FAST = """
[load]
kind = "trapezoid"
magnitude = 0.3
rise = 0.1
start = 0.4
[cases.follows.controller]
strategy = "dual_layer"
[cases.stays.controller]
strategy = "unloaded_jacobian"
"""


def test_result_of_a_load_that_is_too_fast_has_the_best_possible_error(call, write, short):
    path = str(write(short + FAST))
    done = call("run", path, "--jobs", "1", "--json")
    assert done.status == 0
    assert done.err.startswith("ctr-station: follows: the joints cannot compensate load trapezoid: hold ")
    assert len(done.err.splitlines()) == 1
    follows, stays = (json.loads(done.out)["cases"][name] for name in ("follows", "stays"))
    assert follows["warnings"][0] in done.err
    least = follows["best_possible_mm"]
    assert stays["best_possible_mm"] == follows["by_change"]["0.4 s"]["best_possible_mm"] == least
    # Within a tenth of a second the stages barely move, so the best possible error is close to that without control.
    assert 0.8 * stays["true_max_distance_mm"] < least < stays["true_max_distance_mm"]

    table = call("run", path, "--jobs", "1").out
    assert "max distance true from 0.4 s" in table
    assert f"{least:.3f}" in table
    assert "from 0 s on [mm]" in table


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('kind = "hold"', "kind = =", ["not valid TOML", "line 6"]),
        ('title = "short"', 'title = "short"\n"odd\\nkey" = 1', ["unknown key"]),
        ('title = "short"', 'title = "short"\nrobot = "soft.toml"', ["soft.toml", "bending_stiffness = -0.048: Input"]),
    ],
)
def test_run_with_an_invalid_file_prints_one_line_of_error_and_writes_no_files(
    call, write, short, robot_text, tmp_path, old, new, expected
):
    write(robot_text.replace("bending_stiffness = 0.048", "bending_stiffness = -0.048"), "soft")
    assert short.strip().count(old) == 1
    done = call("run", str(write(short.strip().replace(old, new))), "--jobs", "1", "--out", "out", "--json")

    assert done.status == 2
    assert done.out == ""
    assert len(done.err.splitlines()) == 1
    for part in expected:
        assert part in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "fig99"], ["'fig99'", "fig10"]),
        (["run", "fig\n99"], ["'fig 99'"]),
        (["run", "gone.toml"], ["gone.toml: no such file"]),
        (["run", "fig7", "--seed", "x"], ["--seed", "'x'", "2^63"]),
        (["run", "fig7", "--seed", "-1"], ["--seed", "-1", "0 ..."]),
        (["run", "fig7", "--seed", "9223372036854775808"], ["--seed", "9223372036854775808", "2^63 - 1"]),
        (["run", "fig7", "--sed", "1"], ["--sed"]),
        (["run"], ["EXPERIMENT"]),
        (["run", "fig7", "--out", "taken"], ["taken: cannot write results"]),
        (["run", "fig7", "--out", "taken/below"], ["taken/below: cannot write results"]),
        (["run", "fig7", "--out", "x" * 300], ["cannot write results: File name too long"]),
        (["run", "demo", "--calibration", "x" * 5000], ["xxx: File name too long"]),
        (["report", "x" * 5000], ["xxx: File name too long"]),
        (["export", "--format", "csv", "../" * 2000], ["../", ": File name too long"]),
        (["report", ".."], ["..: no run in this folder"]),
        (["replay", "%2e%2e%2f"], ["'%2e%2e%2f' is not one of the runs in runs"]),
        (["export", "--format", "csv", "C:\\CON"], ["'C:\\CON' is not one of the runs in runs"]),
        (["solve", "--sublink", "nan"], ["--sublink", "nan m", "0.0001 ... 0.1 m"]),
        (["solve", "--sublink", "short"], ["--sublink", "'short'", "0.0001 ... 0.1 m"]),
        (["solve", "--robot", "snake"], ["'snake'", "paper"]),
        (["bench", "coffee"], ["coffee", "model", "headless"]),
        (["fly"], ["fly", "run", "solve"]),
    ],
)
def test_invalid_command_line_argument_causes_one_line_of_error_that_names_it(call, tmp_path, arguments, expected):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    done = call(*arguments)

    assert done.status == 2
    assert done.out == ""
    assert len(done.err.splitlines()) == 1
    for part in expected:
        assert part in done.err
    assert folders(tmp_path) == ["taken"]


def test_run_that_cannot_continue_has_a_cause_and_is_kept_as_incomplete(call, write, short, tmp_path):
    # Without feedback a load beyond the strength does not refuse the motion before its start.
    load = '[load]\nkind = "constant"\nmagnitude = 20.0\n[controller]\nstrategy = "unloaded_jacobian"\n'
    path = write(short + load + "[cases.one]\n[cases.two]\n")
    done = call("run", str(path), "--jobs", "1", "--out", "out")

    assert done.status == 1
    assert "one (not completed)" in done.out
    (folder,) = (tmp_path / "out").iterdir()
    assert folders(folder) == ["experiment.toml", "one.mcap", "summary.json"]
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["label"] != "complete"
    assert list(summary["cases"]) == ["one"]
    assert "saturated" in summary["cases"]["one"]["cause"]


@pytest.mark.parametrize("options", [["--exact"], ["--sublink", "0.0025"], ["--robot", "own.toml"]])
def test_solve_accepts_another_model_or_robot(call, write, robot_text, monkeypatch, tmp_path, options):
    write(robot_text.replace("bending_stiffness = 0.0413", "bending_stiffness = 0.0826"))
    request = tmp_path / "request"
    request.write_bytes(GOOD)

    def tip(*arguments: str) -> np.ndarray:
        with request.open(encoding="utf-8") as lines:
            monkeypatch.setattr(sys, "stdin", lines)
            return np.array(json.loads(call("solve", *arguments).out)["tip"])

    # Another sub-link or formulation changes the tip by less than 0.1 mm; a tube twice as stiff by millimetres.
    distance = np.linalg.norm(tip(*options) - tip())
    assert distance > 0.0
    assert (distance < 1e-4) == ("--robot" not in options)


def test_help_lists_the_commands_and_the_experiments(call):
    done = call("--help")

    assert (done.status, done.err) == (0, "")
    for word in ("run", "solve", "bench", "fig10", "fig3"):
        assert word in done.out


def test_missing_command_prints_help_and_exits_with_status_2(call):
    done = call()

    assert done.status == 2
    assert "usage: ctr-station" in done.out


def test_bench_prints_one_json_object_or_a_table(call, monkeypatch):
    from station.benchmarks import model

    whole = model.model
    monkeypatch.setattr(model, "model", lambda: whole(300))

    assert {"solve_us", "accuracy_mm"} <= set(json.loads(call("bench", "model", "--json").out))
    assert "accuracy_mm mean" in call("bench", "model").out
