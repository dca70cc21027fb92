"""What `ctr-station lab` refuses."""

import pytest

from station.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--load", "heavy"), "'heavy' is not a weight"),
        (("--load", "3"), "3 N is outside 0 ... 2 N"),
        (("--load", "nan"), "nan N is outside"),
        (("--config", "none.toml"), "none.toml"),
    ],
)
def test_bad_options_are_refused_in_one_line(capsys, monkeypatch, tmp_path, arguments, told):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(("lab", *arguments))
    except SystemExit as leaves:
        status = int(leaves.code or 0)
    out, err = capsys.readouterr()

    assert (status, out) == (2, "")
    assert told in err
    assert len(err.splitlines()) == 1
