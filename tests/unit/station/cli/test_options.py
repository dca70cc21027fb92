"""Options may have any position on the command line, and no command ignores an option."""

import pytest

from station.cli.main import main, parser
from station.cli.options import move_command_first

COMMANDS = ("run", "report", "serve")


@pytest.mark.parametrize(
    ("given", "read"),
    [
        ("report latest", "report latest"),
        ("--data X report latest", "report --data X latest"),
        ("--data=X report latest", "report --data=X latest"),
        ("--data run report latest", "report --data run latest"),
        ("report --data run latest", "report --data run latest"),
        ("--seed 5 run fig3", "run --seed 5 fig3"),
        ("--no-browser --port 9000 serve", "serve --no-browser --port 9000"),
        ("--lab realistic", "serve --lab realistic"),
        ("", "serve"),
        ("--help", "--help"),
        ("run --help", "run --help"),
    ],
)
def test_options_before_the_command_are_moved_behind_it(given: str, read: str) -> None:
    assert move_command_first(given.split(), COMMANDS, "serve") == read.split()


def test_arguments_of_a_program_without_a_default_command_stay_unchanged() -> None:
    assert move_command_first(["--data", "X"], COMMANDS) == ["--data", "X"]


def test_unknown_option_before_the_command_is_refused(capsys) -> None:
    with pytest.raises(SystemExit) as refused:
        main(("--port", "9000", "report", "latest"))
    assert refused.value.code == 2
    assert "unrecognized arguments: --port" in capsys.readouterr().err


@pytest.mark.parametrize("command", sorted(parser()[1].choices))
def test_every_command_has_the_option_data(command: str) -> None:
    assert "--data" in parser()[1].choices[command].format_help()


@pytest.mark.parametrize(
    "given", ["--json sweep merge {}", "sweep --json merge {}", "sweep merge --json {}", "sweep merge {} --json"]
)
def test_sweep_merge_accepts_options_in_any_position(given: str, tmp_path) -> None:
    top, commands = parser()
    parsed = top.parse_args(move_command_first(given.format(tmp_path).split(), commands.choices))
    assert (parsed.experiment, parsed.parts, parsed.json) == ("merge", tmp_path, True)


def test_unknown_arguments_of_a_sweep_are_refused(capsys) -> None:
    for given in (("sweep", "fig3", "one", "two"), ("sweep", "fig3", "--unknown")):
        with pytest.raises(SystemExit) as refused:
            main(given)
        assert refused.value.code == 2
    with pytest.raises(SystemExit):
        main(("sweep", "--json"))
    assert "required: EXPERIMENT" in capsys.readouterr().err
