"""Options may stand before the command or behind it, and without a command there is one that is meant."""

from collections.abc import Container, Sequence

#: Options without a value that make sense before a command.
FLAGS = ("--no-browser", "--json")
HELP = ("-h", "--help")


def command_first(arguments: Sequence[str], commands: Container[str], meant: str = "") -> list[str]:
    """The same arguments with the command first, so that it reads all of them or refuses what it does not know.

    Args:
        arguments: as they were given.
        commands: their names.
        meant: the command when none is named; empty: none.
    """
    before = ""
    for number, argument in enumerate(arguments):
        is_value = before.startswith("--") and "=" not in before and before not in FLAGS
        if argument in commands and not is_value:
            return [argument, *arguments[:number], *arguments[number + 1 :]]
        if argument in HELP:
            break
        before = argument
    else:
        if meant:
            return [meant, *arguments]
    return list(arguments)
