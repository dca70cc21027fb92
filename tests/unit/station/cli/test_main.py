"""A Ctrl-C inside compiled code ends a command like any other Ctrl-C."""

import argparse

import pytest

from station.cli.main import execute, parser


def interrupted(_: argparse.Namespace) -> int:
    """Raise what compiled code has raised: a Ctrl-C at its boundary, which became a SystemError twice."""
    try:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("unpickling returned a result with an exception set") from error
    except SystemError as error:
        raise SystemError("_inverse returned a result with an exception set") from error


def faulty(_: argparse.Namespace) -> int:
    try:
        raise ValueError("another reason")
    except ValueError as error:
        raise SystemError("a defect") from error


def run(command) -> int:
    top, commands = parser()
    commands.choices["doctor"].set_defaults(command=command)
    return execute(top, commands.choices, ["doctor"])


def test_interrupt_behind_several_errors_is_an_interrupt(capsys):
    assert run(interrupted) == 130
    assert capsys.readouterr().err == "ctr-station: interrupted\n"


def test_system_error_with_another_cause_is_raised():
    with pytest.raises(SystemError, match="a defect"):
        run(faulty)
