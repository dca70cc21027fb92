"""Line numbers of keys in a file with all kinds of tables."""

import pytest

from station.config.toml_lines import line_of

TEXT = '''# a comment with key = 1
title = "x = [ { "
joints.outer.lower = 1
points = [
    [0, 1],  # ]
]
note = """
lower = 5
"""
[devices.stages]
port = "/dev/ttyUSB0"
"odd.name" = 1
[[tubes]]
name = "a"
[[tubes.sections]]
length = 1
[[tubes.sections]]
length = 2
[[tubes]]
name = "b"
[tubes.inner]
deep = { x = 1 }
'''


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("title", 2),
        ("joints.outer.lower", 3),
        ("points.0.1", 4),
        ("devices.stages.port", 11),
        ("devices.stages.missing", 10),
        ("tubes.0.name", 14),
        ("tubes.0.sections.1.length", 18),
        ("tubes.1.name", 20),
        ("tubes.1.inner.deep.x", 22),
        ("lower", None),
        ("key", None),
        ("nothing.at.all", None),
    ],
)
def test_line_number_of_a_toml_key_is_found(key: str, line: int | None) -> None:
    assert line_of(TEXT, key) == line


@pytest.mark.parametrize("text", ["", "[", "[[", "=", "a = ", '"""', "[a]]\n= 3", "x = '''\n", "\x00\n[[]]\n"])
def test_line_numbers_of_any_text_are_determined_without_error(text: str) -> None:
    assert line_of(text, "a.b") is None or text.startswith(("a", "[a"))
