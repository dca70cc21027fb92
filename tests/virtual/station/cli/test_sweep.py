"""The command `sweep`: its table, its JSON output and its folder."""

import json
import sys

import pytest

from station.cli.main import main

TWO = "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"


def test_sweep_prints_one_json_object_and_leaves_a_folder_with_a_report(write, short, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = write(short.replace("duration = 1.0", "duration = 0.3") + TWO)
    arguments = ("--seeds", "2", "--set", "controller.k1=1,5", "--case", "two", "--jobs", "1", "--out", "out")

    assert main(("sweep", str(path), *arguments, "--json")) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert len(out.splitlines()) == 1
    summary = json.loads(out)
    assert (summary["experiment"], summary["completed"], summary["seeds"]) == ("own", True, [0, 1])
    assert [(group["setting"], group["case"], group["runs"]) for group in summary["settings"]] == [
        ({"controller.k1": 1}, "two", 2),
        ({"controller.k1": 5}, "two", 2),
    ]
    spread = summary["settings"][0]["spreads"]["true_max_abs_error_mm.x"]
    single = [run["true_max_abs_error_mm"][0] for run in summary["runs"][:2]]
    assert spread["worst"] == max(single)
    assert spread["median"] == pytest.approx(sum(single) / 2, abs=1e-4)

    folder = tmp_path / summary["recording"]
    assert sorted(path.name for path in folder.iterdir()) == [
        "experiment.toml", "manifest.jsonl", "report.html", "summary.json", "sweep.json",
    ]  # fmt: skip
    kept = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    assert kept == {key: value for key, value in summary.items() if key != "recording"}
    short_summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert short_summary["label"] == "complete"
    assert (folder / "experiment.toml").read_text(encoding="utf-8") == path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--seeds", "0"), "0 is outside 1 ... 100000"),
        (("--seeds", "many"), "'many' is not a whole number"),
        (("--jobs", "-1"), "-1 is outside 1 ... 1024"),
        (("--set", "controller.k1=-1"), "K1 = -1 1/s"),
        (("--set", "nothing"), "write KEY=VALUE"),
        (("--experiments", "nowhere"), "nowhere: no such folder"),
        (("--part", "2"), "'2' is not I/N (part I of N parts), for example 2/4"),
        (("--part", "3/2"), "3 is outside 1 ... 2"),
        (("--part", "1/2"), "--part needs --folder"),
        (("out",), "only follow 'sweep merge'"),
    ],
)
def test_sweep_with_invalid_options_prints_one_line_of_error_and_writes_no_files(
    write, short, tmp_path, monkeypatch, capsys, arguments, expected
):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(("sweep", str(write(short)), *arguments, "--out", "out"))
    except SystemExit as leaves:
        status = leaves.code
    error = capsys.readouterr().err

    assert status == 2
    assert len(error.splitlines()) == 1
    assert expected in error
    assert not (tmp_path / "out").exists()


def quick(write, short, text=""):
    return str(write(short.replace("duration = 1.0", "duration = 0.2") + text))


def test_repeated_sweep_continues_and_a_different_one_is_refused(write, short, call, tmp_path):
    command = ("sweep", quick(write, short), "--jobs", "1", "--folder", "here")
    assert call(*command, "--seeds", "2").status == 0
    manifest = tmp_path / "here" / "manifest.jsonl"
    whole = manifest.read_bytes()
    manifest.write_bytes(whole[:-50])  # kill -9 leaves a manifest with a truncated last line

    again = call(*command, "--seeds", "2")
    assert again.status == 0
    assert "2 of 2 runs, 1 of them now, in" in again.out
    one, other = (json.loads(data.splitlines()[-1]) for data in (whole, manifest.read_bytes()))
    assert {**one, "wall_s": 0.0} == {**other, "wall_s": 0.0}
    assert "2 of 2 runs, 0 of them now, in" in call(*command, "--seeds", "2").out
    refused = call(*command, "--seeds", "3")
    assert (refused.status, refused.out) == (2, "")
    assert "here/manifest.jsonl: the folder has another sweep: --seeds: 2 stored, 3 requested" in refused.err


def test_sweep_without_a_folder_continues_if_incomplete_and_gets_a_new_folder_if_complete(write, short, call, tmp_path):
    command = ("sweep", quick(write, short), "--jobs", "1", "--seeds", "2", "--json")
    first = json.loads(call(*command).out)["recording"]
    second = json.loads(call(*command).out)["recording"]
    assert first != second
    manifest = tmp_path / second / "manifest.jsonl"
    manifest.write_bytes(manifest.read_bytes()[:-50])
    assert json.loads(call(*command).out)["recording"] == second


def test_merged_parts_of_a_sweep_equal_the_whole_sweep(write, short, call, tmp_path):
    command = ("sweep", quick(write, short, TWO), "--seeds", "2", "--jobs", "1")
    whole = json.loads(call(*command, "--json").out)
    for part in ("2/3", "1/3"):
        assert call(*command, "--folder", "parts", "--part", part).status == 0
    early = call("sweep", "merge", "parts")
    assert (early.status, early.out) == (2, "")
    assert "parts/manifest-3-of-3.jsonl is missing: carry out the sweep with --part 3/3" in early.err
    last = call(*command, "--folder", "parts", "--part", "3/3")
    assert "part 3/3: 1 of 1 runs in" in last.out
    assert "ctr-station sweep merge parts" in last.out

    merged = call("sweep", "merge", "parts", "--json")
    assert merged.status == 0
    summary = json.loads(merged.out)
    clocks = {"wall_s": 0.0}
    assert [{**run, **clocks} for run in summary["runs"]] == [{**run, **clocks} for run in whole["runs"]]
    assert [run["run"] for run in summary["runs"]] == [0, 1, 2, 3]
    assert {**summary, "runs": [], "recording": "", **clocks} == {**whole, "runs": [], "recording": "", **clocks}
    assert (tmp_path / "parts" / "report.html").is_file()
    assert "4 runs of 3 parts" in call("sweep", "merge", "parts").out


def test_failed_run_of_a_sweep_appears_in_its_table_and_exit_status(write, short, call):
    lost = '[[cases.lost.faults]]\nkind = "mute"\ndevice = "tracker"\nat = 0.1\n'
    experiment = quick(write, short, f"[cases.good]\n{lost}")
    done = call("sweep", experiment, "--seeds", "1", "--jobs", "1", "--set", "duration=0.6")

    assert done.status == 1
    assert "1 of 1" in done.out
    assert "0 of 1" in done.out
    assert "duration = 0.6, lost, seed 0: " in done.out
    assert "2 of 2 runs in" in done.out


def test_sweep_on_a_cluster_without_dask_is_refused_with_the_name_of_the_extra(
    write, short, call, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused = call("sweep", quick(write, short), "--scheduler", "local", "--folder", "here")

    assert refused.status == 2
    assert "--scheduler needs the package distributed: pip install 'ctr-station[dask]'" in refused.err
    assert not (tmp_path / "here").exists()
