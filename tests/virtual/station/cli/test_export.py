"""`ctr-station export`: conversion of a run to files; the run is given by name, by folder, or as the latest."""

from pathlib import Path


def test_latest_run_is_exported_to_a_csv_file(call, write, short):
    assert call("run", str(write(short)), "--jobs", "1").status == 0
    done = call("export", "latest", "--format", "csv")
    assert done.status == 0, done.err
    path = Path(done.out.strip())

    assert path.name == "own.csv"
    assert len(path.read_text(encoding="utf-8").splitlines()) == 501

    wrong = call("export", "yesterday", "--format", "mat")
    assert wrong.status == 2
    assert wrong.err == "ctr-station: 'yesterday' is not one of the runs in runs\n"
