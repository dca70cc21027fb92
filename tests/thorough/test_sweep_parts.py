"""A sweep that is continued, or carried out in parts, equals the whole sweep."""

import json

TWO = "[cases.one]\n[cases.two.controller]\nfeedforward = true\n"


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
    assert "here/manifest.jsonl: the folder has other results: seeds: 2 stored, 3 requested" in refused.err


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
