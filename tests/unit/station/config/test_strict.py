"""An invalid configuration is refused in one line with file, key, value and the expected value."""

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError

from station.config.strict import (
    EXPERIMENTS_VARIABLE,
    PRESETS,
    ConfigError,
    Direction,
    Line,
    Name,
    NotNegative,
    Positive,
    Row,
    Strict,
    Vector,
    check,
    line_of,
    merged,
    preset,
    preset_names,
    read_toml,
    text_of,
    toml_lines,
    use_experiments,
)


class Wheel(Strict):
    name: Name = "wheel"
    radius: Positive
    mass: NotNegative = 1.0
    axis: Direction = (0.0, 0.0, 1.0)
    place: Vector = (0.0, 0.0, 0.0)


class Motor(Strict):
    kind: Literal["motor"] = "motor"
    power: float


class Sail(Strict):
    kind: Literal["sail"] = "sail"
    area: float


class Cart(Strict):
    wheel: Wheel
    spare: Annotated[tuple[Wheel, ...], Row] = ()
    by_place: Mapping[str, Wheel] = {}
    drive: Annotated[Motor | Sail, Field(discriminator="kind")] = Sail(area=1.0)
    braked: bool = False
    driver: str = ""


GOOD = {"wheel": {"radius": 0.3}}


def refusal(table: Mapping[str, object]) -> str:
    with pytest.raises(ConfigError) as refused:
        check(Cart, table, "cart.toml")
    message = str(refused.value)
    assert "\n" not in message
    assert message.startswith("cart.toml: ")
    return message.removeprefix("cart.toml: ")


def test_arrays_and_integers_of_a_configuration_file_become_tuples_and_floats():
    cart = check(
        Cart,
        {
            "wheel": {"radius": 1, "place": [1, 2, 3]},
            "spare": [{"radius": 2.0}],
            "by_place": {"front": {"radius": 3.0}},
            "drive": {"kind": "motor", "power": 5},
        },
        "cart.toml",
    )

    assert cart.wheel.place == (1.0, 2.0, 3.0)
    assert [wheel.radius for wheel in cart.spare] == [2.0]
    assert cart.by_place["front"].radius == 3.0
    assert cart.drive == Motor(power=5.0)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({**GOOD, "wheels": 4}, "unknown key 'wheels'"),
        ({"wheel": {"radius": 0.3, "colour": "red"}}, "unknown key 'wheel.colour'"),
        ({"spare": []}, "'wheel' is missing"),
        ({"wheel": {}}, "'wheel.radius' is missing"),
        ({"wheel": {"radius": "0.3"}}, "wheel.radius = '0.3': Input should be a valid number"),
        ({"wheel": {"radius": float("nan")}}, "wheel.radius = nan: Input should be a finite number"),
        ({"wheel": {"radius": 0.0}}, "wheel.radius = 0.0: Input should be greater than 0"),
        ({"wheel": {"radius": 0.3, "mass": -1.0}}, "wheel.mass = -1.0: Input should be greater than or equal to 0"),
        ({"wheel": {"radius": 0.3, "name": "../a"}}, "wheel.name = '../a': "),
        ({"wheel": {"radius": 0.3, "place": [1.0, 2.0]}}, "'wheel.place.2' is missing"),
        ({**GOOD, "spare": [{"radius": 1.0}, {"radius": -1.0}]}, "spare.1.radius = -1.0: "),
        ({**GOOD, "drive": {"kind": "horse"}}, "drive = {'kind': 'horse'}: "),
        ({**GOOD, "braked": 1}, "braked = 1: Input should be a valid boolean"),
        ({**GOOD, "driver": 7}, "driver = 7: Input should be a valid string"),
    ],
)
def test_wrong_key_of_a_configuration_is_refused_by_name_with_its_value(table, message):
    assert refusal(table).startswith(message)


@pytest.mark.parametrize("axis", [[0, 0, 0], [0.0, 1e-12, 0.0], [1e300, 1e300, 0.0]])
def test_direction_without_a_usable_length_is_refused(axis):
    assert "the length of a direction must be 1e-9 ... 1e9" in refusal({"wheel": {"radius": 1.0, "axis": axis}})


def test_all_errors_of_a_configuration_are_reported_together():
    message = refusal({"wheel": {"radius": -1.0, "mass": -1.0}, "braked": 3})

    assert message == (
        "wheel.radius = -1.0: Input should be greater than 0;"
        " wheel.mass = -1.0: Input should be greater than or equal to 0; braked = 3: Input should be a valid boolean"
    )


def test_configuration_errors_beyond_the_limit_are_only_counted():
    message = refusal({**GOOD, "spare": [{"radius": -1.0}] * 20})

    assert message.count("Input should be greater than 0") == 6
    assert message.endswith("; and 14 more")


def test_each_configuration_error_has_its_line_number(write):
    path = write("braked = 3\n[wheel]\nradius = -1.0\n")
    with pytest.raises(ConfigError, match=r"braked = 3: .* \(line 1\)$") as refused:
        check(Cart, read_toml(path), str(path))
    assert "wheel.radius = -1.0: Input should be greater than 0 (line 3); braked" in str(refused.value)


def test_misspelt_key_is_named_as_the_file_has_it():
    assert refusal({"wheel": {"radios": 0.3}}) == "unknown key 'wheel.radios'; 'wheel.radius' is missing"


def test_long_value_is_truncated_in_the_configuration_error():
    assert len(refusal({"wheel": {"radius": "9" * 5000}})) < 200


def test_file_that_is_not_toml_is_refused_with_the_line(write):
    path = write("a = 1\nb = = 2\n")

    with pytest.raises(ConfigError, match=r"own\.toml: not valid TOML: .*line 2") as refused:
        read_toml(path)
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize("text", ["a = " + "1" * 5000, "a = " + "[" * 100_000], ids=["digits", "brackets"])
def test_toml_that_breaks_the_parser_is_refused(write, text):
    with pytest.raises(ConfigError, match=r"own\.toml: not valid TOML: "):
        read_toml(write(text))


def test_configuration_that_is_not_text_or_not_a_file_is_refused(tmp_path):
    (tmp_path / "bytes.toml").write_bytes(b"b = 1\na = '\xff'")

    with pytest.raises(ConfigError, match=r"bytes\.toml: not UTF-8 text: byte 0xff \(line 2\); save it as UTF-8"):
        read_toml(tmp_path / "bytes.toml")
    with pytest.raises(ConfigError, match=r"cannot be read: Is a directory"):
        read_toml(tmp_path)


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"])
def test_text_is_read_in_each_unicode_encoding_with_and_without_a_byte_order_mark(encoding, mark):
    assert text_of(f"{mark}a = 'Röhre 管'\r\nb = 1\r".encode(encoding)) == "a = 'Röhre 管'\nb = 1\n"
    assert text_of(mark.encode(encoding)) == ""


@pytest.mark.parametrize("kind", ["robots", "labs", "experiments"])
def test_preset_is_found_by_the_name_it_is_listed_with(kind):
    assert preset_names(kind)
    assert all(preset(kind, name).is_file() for name in preset_names(kind))


@pytest.mark.parametrize("name", ["fig99", "", "fig10.tml", "../experiments/fig10"])
def test_unknown_preset_is_refused_with_the_list(name):
    with pytest.raises(ConfigError) as refused:
        preset("experiments", name)

    assert f"'{name}' is not one of the experiments: " in str(refused.value)
    assert "fig3, fig4, fig6, fig7, fig8, fig10" in str(refused.value)


def test_path_of_a_custom_file_is_used_unchanged_and_named_if_missing(write, tmp_path):
    assert preset("experiments", str(write(""))) == tmp_path / "own.toml"
    with pytest.raises(ConfigError, match=r"nowhere\.toml: no such file"):
        preset("experiments", str(tmp_path / "nowhere.toml"))


@pytest.fixture
def own_experiments(monkeypatch, tmp_path):
    """Create a folder with two custom experiments and use it."""
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")  # monkeypatch restores the variable after the test
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("hold_still", "fig10"):
        (folder / f"{name}.toml").write_text("", encoding="utf-8")
    use_experiments(folder)
    return folder


def test_custom_experiments_are_found_by_name_and_replace_those_of_the_station(own_experiments):
    assert {"hold_still", "fig10", "fig7"} <= set(preset_names("experiments"))
    assert preset("experiments", "hold_still") == own_experiments / "hold_still.toml"
    assert preset("experiments", "fig10") == own_experiments / "fig10.toml"
    assert preset("experiments", "fig7").parent == PRESETS / "experiments"
    assert "hold_still" not in preset_names("labs")
    with pytest.raises(ConfigError, match="fig10, follow, hold_still"):
        preset("experiments", "fig99")


@pytest.mark.parametrize("name", ["._square.toml", ".#square.toml", ".~lock.square.toml", ".toml"])
def test_hidden_file_is_not_listed_as_a_custom_experiment(own_experiments, name):
    listed = preset_names("experiments")
    (own_experiments / name).write_bytes(b"\x00\x05\x16\x07")
    assert preset_names("experiments") == listed


def test_missing_folder_of_experiments_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="nowhere: no such folder of experiments"):
        use_experiments(tmp_path / "nowhere")


def test_merged_tables_are_combined_key_by_key_without_changing_the_base():
    base = {"a": 1, "deep": {"b": 2, "c": {"d": 3, "e": 4}}}

    assert merged(base, {"deep": {"c": {"e": 5}, "f": 6}}) == {"a": 1, "deep": {"b": 2, "c": {"d": 3, "e": 5}, "f": 6}}
    assert base == {"a": 1, "deep": {"b": 2, "c": {"d": 3, "e": 4}}}


def test_merging_replaces_a_whole_table_if_its_kind_differs():
    base = {"load": {"kind": "constant", "magnitude": 0.5, "direction": [0, 0, 1]}}

    assert merged(base, {"load": {"kind": "sine", "amplitude": 0.2}}) == {"load": {"kind": "sine", "amplitude": 0.2}}
    assert merged(base, {"load": {"kind": "constant", "magnitude": 1.0}})["load"]["direction"] == [0, 0, 1]
    assert merged(base, {"load": {"magnitude": 1.0}})["load"]["kind"] == "constant"
    assert merged(base, {"load": 3}) == {"load": 3}


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


def test_fifo_in_the_folder_of_experiments_is_refused_without_waiting_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, str(tmp_path))
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(ConfigError, match=r"pipe\.toml: not a file"):
        preset("experiments", "pipe")


def test_experiment_whose_file_name_has_a_line_break_is_not_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, str(tmp_path))
    (tmp_path / "two\nlines.toml").write_text("")
    (tmp_path / "one.toml").write_text("")
    assert "one" in preset_names("experiments")
    assert "two\nlines" not in preset_names("experiments")


@pytest.mark.parametrize("text", ["two\nlines", "\x1b[2J", "\x00", "\x85", "line\u2028separator"])
def test_text_of_a_single_line_has_no_control_characters(text: str) -> None:
    class Named(Strict):
        name: Line

    assert Named(name="Röhre µ 管 'x'").name
    with pytest.raises(ValidationError, match="control characters are not allowed"):
        Named(name=text)
