"""Values written as TOML are read back unchanged."""

import tomllib

from station.config.toml_text import toml_lines

TABLE = {
    "text": 'a "quoted" \\ line\nand µ\x7f\x00',
    "truth": True,
    "count": 3,
    "number": 1e-7,
    "large": 1e300,
    "list": [1.0, -2.5],
    "rows": [[0.0, 1.0], [2.0, 3.0]],
    "empty": [],
    "table": {"inner_rotation": 1.5, "no": False},
}


def test_every_kind_of_value_written_as_toml_is_read_back() -> None:
    assert tomllib.loads("\n".join(toml_lines(TABLE))) == TABLE


def test_keys_with_the_value_none_are_not_written_as_toml() -> None:
    assert toml_lines({"stay": None, "offset": 1.0}) == ["offset = 1.0"]
