"""Reorder command-line arguments, so that options may precede the command and a default command may be omitted."""

from collections.abc import Container, Sequence

#: Options without a value that may precede a command; every other option is followed by its value.
SERVE_FLAGS = ("--no-browser", "--json")
HELP_FLAGS = ("-h", "--help")


def move_command_first(arguments: Sequence[str], commands: Container[str], meant: str = "") -> list[str]:
    """Return the arguments with the command first, so that its parser reads all of them or rejects unknown ones.

    Args:
        arguments: arguments of the command line, in their original order.
        commands: names of all commands.
        meant: default command if no command is named; empty if there is no default.
    """
    before = ""
    for number, argument in enumerate(arguments):
        is_value = before.startswith("--") and "=" not in before and before not in SERVE_FLAGS
        if argument in commands and not is_value:
            return [argument, *arguments[:number], *arguments[number + 1 :]]
        if argument in HELP_FLAGS:
            break
        before = argument
    else:
        if meant:
            return [meant, *arguments]
    return list(arguments)
