"""A command that waits for the compiler writes one message."""

import numba
import pytest

import core.compiled  # noqa: F401 - its listener logs what is compiled
from station.cli import compile_notice


@pytest.mark.parametrize(("patience", "messages"), [(0.0, 1), (3600.0, 0)])
def test_command_that_compiles_for_long_says_so_once(monkeypatch, capsys, patience, messages):
    monkeypatch.setattr(compile_notice, "PATIENCE_S", patience)
    with compile_notice.noticed_compilation():
        assert [numba.njit(lambda x, more=more: x + more)(1) for more in (1, 2, 3)] == [2, 3, 4]
    assert capsys.readouterr().err.count("compiling the model for this computer") == messages
