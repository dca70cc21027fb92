"""Where options may stand, and that no command leaves one unread."""

import pytest

from station.cli.main import main, parser
from station.cli.placed import command_first

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
def test_the_command_comes_first_and_reads_everything(given: str, read: str) -> None:
    assert command_first(given.split(), COMMANDS, "serve") == read.split()


def test_without_a_command_that_is_meant_there_is_none() -> None:
    assert command_first(["--data", "X"], COMMANDS) == ["--data", "X"]


def test_what_a_command_does_not_know_is_refused_wherever_it_stands(capsys) -> None:
    with pytest.raises(SystemExit) as refused:
        main(("--port", "9000", "report", "latest"))
    assert refused.value.code == 2
    assert "unrecognized arguments: --port" in capsys.readouterr().err


@pytest.mark.parametrize("command", sorted(parser()[1].choices))
def test_every_command_takes_the_folder_of_data(command: str) -> None:
    assert "--data" in parser()[1].choices[command].format_help()


@pytest.mark.parametrize(
    "given",
    ["--json sweep merge {}", "sweep --json merge {}", "sweep merge --json {}", "sweep merge {} --json"],
)
def test_the_options_of_a_merge_stand_anywhere(given: str, tmp_path) -> None:
    top, commands = parser()
    parsed = top.parse_args(command_first(given.format(tmp_path).split(), commands.choices))
    assert (parsed.experiment, parsed.parts, parsed.json) == ("merge", tmp_path, True)


def test_words_that_a_sweep_does_not_know_are_still_refused(capsys) -> None:
    for given in (("sweep", "fig3", "one", "two"), ("sweep", "fig3", "--unknown")):
        with pytest.raises(SystemExit) as refused:
            main(given)
        assert refused.value.code == 2
    with pytest.raises(SystemExit):
        main(("sweep", "--json"))
    assert "required: EXPERIMENT" in capsys.readouterr().err
