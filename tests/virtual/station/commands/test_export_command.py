"""`ctr-station export`: from a run to files, by name, by folder or the newest."""

import pytest


@pytest.fixture
def run(command_line, write, short):
    done = command_line("run", str(write(short)))
    assert done.returncode == 0, done.stderr


def test_the_newest_run_becomes_a_csv_file(run, command_line, tmp_path):
    done = command_line("export", "latest", "--format", "csv")
    assert done.returncode == 0, done.stderr
    path = tmp_path / done.stdout.decode().strip()

    assert path.name == "own.csv"
    assert len(path.read_text(encoding="utf-8").splitlines()) == 501

    wrong = command_line("export", "yesterday", "--format", "mat")
    assert wrong.returncode == 2
    assert wrong.stderr == b"ctr-station: 'yesterday' is not one of the runs in runs\n"
