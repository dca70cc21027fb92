"""Refusals of `ctr-station lab`."""

import pytest

from station.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--load", "heavy"), "'heavy' is not a weight"),
        (("--load", "3"), "3 N is outside 0 ... 2 N"),
        (("--load", "nan"), "nan N is outside"),
        (("--config", "none.toml"), "none.toml"),
    ],
)
def test_lab_command_refuses_invalid_options_in_one_line(capsys, monkeypatch, tmp_path, arguments, expected):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(("lab", *arguments))
    except SystemExit as leaves:
        status = int(leaves.code or 0)
    out, err = capsys.readouterr()

    assert (status, out) == (2, "")
    assert expected in err
    assert len(err.splitlines()) == 1
