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


def test_sweep_on_a_cluster_without_dask_is_refused_with_the_name_of_the_extra(
    write, short, call, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused = call("sweep", quick(write, short), "--scheduler", "local", "--folder", "here")

    assert refused.status == 2
    assert "argument --scheduler: needs the package distributed: pip install 'ctr-station[dask]'" in refused.err
    assert not (tmp_path / "here").exists()
