"""What a calibration writes can be read again, whatever a person has called things."""

import tomllib

import pytest

from station.calibration.files import toml_string


@pytest.mark.parametrize("text", ["plain", 'a "quoted" \\ name', "two\nlines", "\x1b[0m tab\t", "Zoë \x7f \x85", ""])
def test_any_text_comes_back_as_it_was(text: str) -> None:
    written = toml_string(text)
    assert "\n" not in written
    assert tomllib.loads(f"text = {written}")["text"] == text
