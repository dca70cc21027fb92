"""ATI calibration files in both forms, and the conversion of six voltages to a wrench."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.ati.calibration import (
    AXES,
    CalibrationError,
    PageError,
    parse_calibration,
    read_calibration,
    read_page,
)

ELEMENTS = {"prodname": "Net F/T", "cfgcpf": "1000000", "cfgcpt": "1000000", "scfgfu": "N", "scfgtu": "N-m"}


def page(extra: str = "", head: str = '<?xml version="1.0"?>', **changes: str | None) -> bytes:
    """Return a page with changed elements; None omits an element."""
    elements = {**ELEMENTS, **changes}
    body = "".join(f"<{name}>{text}</{name}>\n" for name, text in elements.items() if text is not None)
    return f"{head}<netft><runft>1;2;3;4;5;6</runft>{body}{extra}</netft>".encode()


def test_page_gives_force_and_torque_per_count():
    read = read_page(page())

    assert (read.product, read.serial, read.ranges) == ("Net F/T", "", None)
    assert (read.force_count, read.torque_count) == (1e-6, 1e-6)


#: Units per pound-force and per inch-pound: the numbers in ATI's C library (`ForceConv` and `TorqueConv`, ftconfig.c).
FORCES = {
    "lb": 1.0, "lbf": 1.0, "klb": 0.001, "klbf": 0.001, "N": 4.44822161526, "kN": 0.00444822161526,
    "kg": 0.45359237, "kgf": 0.45359237, "g": 453.59237, "gf": 453.59237,
}  # fmt: skip
TORQUES = {
    "in-lb": 1.0, "in-lbf": 1.0, "lb-in": 1.0, "lbf-in": 1.0,
    "ft-lb": 0.08333333333, "lb-ft": 0.08333333333, "ft-lbf": 0.08333333333, "lbf-ft": 0.08333333333,
    "N-m": 0.112984829028, "Nm": 0.112984829028, "N-mm": 112.984829028, "Nmm": 112.984829028,
    "kg-cm": 1.1521246198, "kgcm": 1.1521246198, "kgf-cm": 1.1521246198,
    "kN-m": 0.000112984829028, "kNm": 0.000112984829028,
}  # fmt: skip


@pytest.mark.parametrize("unit", FORCES)
def test_force_units_are_converted_to_newtons(unit):
    newtons = FORCES["N"] / FORCES[unit]

    assert read_page(page(scfgfu=unit, cfgcpf="1000")).force_count == pytest.approx(newtons / 1000.0, rel=1e-9)
    assert parse_calibration(file(AXIS_ROWS, ForceUnits=unit)).matrix[1, 1] == pytest.approx(2.0 * newtons, rel=1e-9)


@pytest.mark.parametrize("unit", TORQUES)
def test_torque_units_are_converted_to_newton_metres(unit):
    factor = TORQUES["N-m"] / TORQUES[unit]

    assert read_page(page(scfgtu=unit, cfgcpt="1000")).torque_count == pytest.approx(factor / 1000.0, rel=1e-9)
    assert parse_calibration(file(AXIS_ROWS, TorqueUnits=unit)).matrix[5, 5] == pytest.approx(4.0 * factor, rel=1e-9)


@pytest.mark.parametrize("text", ["18;18;18;250;250;250", "18,18,18,250,250,250", "18 18 18 250 250 250"])
def test_identity_and_range_are_optional_in_the_page(text):
    read = read_page(page(scfgtu="N-mm", cfgcalsn="FT12345", cfgmr=text))

    assert read.serial == "FT12345"
    assert read.ranges == pytest.approx((18.0, 18.0, 18.0, 0.25, 0.25, 0.25))


@pytest.mark.parametrize("text", ["0;0;0;0;0;0", "18;18;18", "a;b;c;d;e;f", ""])
def test_invalid_range_is_ignored(text):
    assert read_page(page(cfgmr=text)).ranges is None


@pytest.mark.parametrize("name", ELEMENTS)
def test_missing_element_of_the_page_is_named(name):
    with pytest.raises(PageError, match=f"no <{name}>"):
        read_page(page(**{name: None}))


@pytest.mark.parametrize("name", ELEMENTS)
def test_duplicate_element_of_the_page_is_named(name):
    with pytest.raises(PageError, match=f"<{name}> twice"):
        read_page(page(extra=f"<{name}>{ELEMENTS[name]}</{name}>"))


@pytest.mark.parametrize(
    "text", ["0", "-1", "nan", "inf", "1e400", "1e-300", "", "1_000", "0x10", "1,5", "++1", "\u0661"]
)
@pytest.mark.parametrize("name", ["cfgcpf", "cfgcpt"])
def test_counts_must_be_positive_finite_numbers(name, text):
    with pytest.raises(PageError, match=f"<{name}>"):
        read_page(page(**{name: text}))


@pytest.mark.parametrize(("name", "text"), [("scfgfu", "n"), ("scfgfu", "N-m"), ("scfgtu", "N"), ("scfgtu", "")])
def test_unknown_unit_on_the_sensors_page_is_refused_with_its_name(name, text):
    with pytest.raises(PageError, match=f"<{name}> is '{text}'"):
        read_page(page(**{name: text}))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (page(head='<!DOCTYPE netft [<!ENTITY a "1000000">]>', cfgcpf="&a;"), "DOCTYPE"),
        (page(cfgcpf="<b>1000000</b>"), "contains <b>"),
        (page()[:-3], "well-formed"),
        (page().replace(b"</scfgfu>", b"</scfgtu>"), "well-formed"),
        (page(head='<?xml version="1.0" encoding="ebcdic-9"?>'), "well-formed"),
        (b"", "well-formed"),
        (b"<html><body>Not here</body></html>", "no <prodname>"),
        (page(extra="<x>" + "a" * 300_000 + "</x>"), "bytes"),
    ],
)
def test_invalid_page_is_refused(data, reason):
    with pytest.raises(PageError, match=reason):
        read_page(data)


@given(st.binary(max_size=300))
def test_random_bytes_are_refused_as_a_page(data):
    with pytest.raises(PageError):
        read_page(data)


HEAD = {
    "PartNumber": "SI-18-0.25",
    "ForceUnits": "N",
    "TorqueUnits": "N-mm",
    "DistUnits": "mm",
    "OutputRange": "20",
    "OutputBipolar": "True",
}
TRANSFORM = '<BasicTransform Dx="0" Dy="0" Dz="4.5" Rx="0" Ry="0" Rz="0"/>'
#: Coefficients with simple numbers: gauge i affects axis i, and the fourth gauge also affects Fx.
VALUES = np.diag([32.0, 32.0, 16.0, 8.0, 8.0, 8.0])
VALUES[0, 3] = -64.0
SCALES = (16.0, 16.0, 8.0, 2.0, 2.0, 2.0)
MAX = (18, 18, 18, 250, 250, 250)


def rows(kind: str, values: np.ndarray, scales=None) -> str:
    return "".join(
        f'<{kind} Name="{axis}" values="  {"  ".join(f"{v:.5f}" for v in values[i])} " max="{MAX[i]}"'
        + (f' scale="{scales[i]}"/>' if scales else "/>")
        for i, axis in enumerate(AXES)
    )


def file(body: str, **head: str) -> bytes:
    attributes = " ".join(f'{name}="{text}"' for name, text in {**HEAD, **head}.items())
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<!-- a comment -->\n'
        f'<FTSensor Serial="FT9999" BodyStyle="Nano43" NumGages="6" CalFileVersion="1.0"><Calibration {attributes}>'
        f"{body}</Calibration></FTSensor>"
    ).encode()


AXIS_ROWS = rows("Axis", VALUES, SCALES)
#: Computed by hand: rows divided by their scales; about a point p at 4.5 mm along z the moments are T - p x F,
#: that is Tx + 4.5 Fy and Ty - 4.5 Fx [N mm].
USER = np.array(
    [
        [2.0, 0.0, 0.0, -4.0, 0.0, 0.0],
        [0.0, 2.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 2.0, 0.0, 0.0, 0.0],
        [0.0, 9.0, 0.0, 4.0, 0.0, 0.0],
        [-9.0, 0.0, 0.0, 18.0, 4.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 4.0],
    ]
)
SI = USER * np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])[:, None]


@pytest.mark.parametrize(
    "body",
    [AXIS_ROWS + TRANSFORM, AXIS_ROWS + TRANSFORM + rows("UserAxis", USER), rows("UserAxis", USER)],
    ids=["axis rows only", "both", "user rows only"],
)
def test_every_form_of_the_calibration_file_gives_the_same_matrix(body):
    calibration = parse_calibration(file(body))

    assert calibration.matrix == pytest.approx(SI, abs=1e-12)
    assert calibration.ranges == pytest.approx([18.0] * 3 + [0.25] * 3)
    assert (calibration.serial, calibration.part, calibration.volts) == ("FT9999", "SI-18-0.25", 10.0)


def test_wrench_is_computed_from_voltages_minus_bias():
    calibration = parse_calibration(file(AXIS_ROWS + TRANSFORM))
    bias = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.5])

    loaded = calibration.mean_wrench(np.array([[1.1, 0.8, 0.3, 0.5, 0.5, 0.5]]).T)
    unloaded = calibration.mean_wrench(bias[:, None])

    # The voltages are (1, 1, 0, 0.5, 0, 1) V above the bias.
    assert loaded is not None
    assert unloaded is not None
    assert loaded - unloaded == pytest.approx([0.0, 2.0, 0.0, 0.011, 0.0, 0.004], abs=1e-12)


@pytest.mark.parametrize(("volts", "saturated"), [(9.99, False), (10.0, True), (-10.0, True), (np.nan, True)])
def test_saturated_gauge_is_detected(volts, saturated):
    calibration = parse_calibration(file(AXIS_ROWS))

    assert (calibration.mean_wrench(np.array([[0.0, 0.0, volts, 0.0, 0.0, 0.0]]).T) is None) is saturated


def test_wrench_uses_the_units_of_the_calibration_file():
    metres = parse_calibration(
        file(AXIS_ROWS + TRANSFORM.replace('"4.5"', '"0.0045"'), TorqueUnits="N-mm", DistUnits="m")
    )
    pounds = parse_calibration(file(AXIS_ROWS, ForceUnits="lbf", TorqueUnits="lbf-in"))

    assert metres.matrix == pytest.approx(SI, abs=1e-12)
    assert pounds.matrix[1, 1] == pytest.approx(2.0 * 4.448222, rel=1e-6)
    assert pounds.matrix[5, 5] == pytest.approx(4.0 * 0.1129848, rel=1e-6)


@pytest.mark.parametrize(
    ("unit", "text"),
    [("in", "0.17716535433"), ("ft", "0.014763779528"), ("cm", "0.45"), ("m", "0.0045"), ("mm", "4.5")],
)
def test_position_of_the_tool_has_the_length_unit_of_the_file(unit, text):
    body = AXIS_ROWS + TRANSFORM.replace('"4.5"', f'"{text}"')

    assert parse_calibration(file(body, DistUnits=unit)).matrix == pytest.approx(SI, abs=1e-9)


def library_transform(lengths: list[float], angles: list[float]) -> np.ndarray:
    """Return the elements that `TTM` of ATI's C library (ftconfig.c) computes, lengths in [m] and angles in [rad]."""
    (dx, dy, dz), (sx, sy, sz), (cx, cy, cz) = lengths, np.sin(angles), np.cos(angles)
    r = [
        [cy * cz, sx * sy * cz + cx * sz, sx * sz - cx * sy * cz],
        [-cy * sz, -sx * sy * sz + cx * cz, sx * cz + cx * sy * sz],
        [sy, -sx * cy, cx * cy],
    ]
    lower = [[a[2] * dy - a[1] * dz, a[0] * dz - a[2] * dx, a[1] * dx - a[0] * dy, *a] for a in r]
    return np.array([[*a, 0.0, 0.0, 0.0] for a in r] + lower)


@pytest.mark.parametrize("unit", ["deg", "degree", "degrees", "rad", "radian", "radians", None])
def test_rotated_tool_transform_is_applied_as_by_the_makers_library(unit):
    given = [0.5, -1.1, 2.0] if unit and unit.startswith("rad") else [30.0, -65.0, 110.0]
    names = " ".join(f'R{axis}="{value}"' for axis, value in zip("xyz", given, strict=True))
    body = AXIS_ROWS + f'<BasicTransform Dx="3" Dy="-7" Dz="4.5" {names}/>'
    plain = parse_calibration(file(AXIS_ROWS)).matrix
    angles = given if unit and unit.startswith("rad") else np.radians(given).tolist()

    read = parse_calibration(file(body, **({"AngleUnits": unit} if unit else {}))).matrix

    assert read == pytest.approx(library_transform([0.003, -0.007, 0.0045], angles) @ plain, abs=1e-12)


@pytest.mark.parametrize(
    ("axis", "force"), [("Rx", [1.0, 3.0, -2.0]), ("Ry", [-3.0, 2.0, 1.0]), ("Rz", [2.0, -1.0, 3.0])]
)
def test_quarter_turn_of_the_tool_permutes_the_force(axis, force):
    """Rotating the tool about z takes its x axis to the transducer's y axis, so that Fx of the tool is Fy."""
    turned = parse_calibration(file(AXIS_ROWS + f'<BasicTransform {axis}="90"/>')).matrix
    plain = parse_calibration(file(AXIS_ROWS)).matrix
    voltages = np.linalg.solve(plain, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0])

    assert turned @ voltages == pytest.approx([*force, 0.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (file(""), "neither"),
        (file(AXIS_ROWS.replace('Name="Tz"', 'Name="Ty"')), "each once"),
        (file(AXIS_ROWS.replace('scale="8.0"', 'scale="0"')), "Fz: scale is '0'"),
        (file(AXIS_ROWS.replace('scale="8.0"', 'scale="nan"')), "Fz: scale is 'nan'"),
        (file(AXIS_ROWS.replace("32.00000", "x", 1)), "Fx: values"),
        (file(AXIS_ROWS.replace("32.00000", "", 1)), "Fx: values"),
        (file(AXIS_ROWS, ForceUnits="stone"), "ForceUnits is 'stone'"),
        (file(AXIS_ROWS, OutputRange="-20"), "OutputRange is '-20'"),
        (file(AXIS_ROWS, TorqueUnits="n-mm"), "TorqueUnits is 'n-mm'; expected one of N-m, Nm, N-mm"),
        (file(AXIS_ROWS + TRANSFORM, DistUnits="yd"), "DistUnits is 'yd'; expected one of mm, cm, m, in, ft"),
        (file(AXIS_ROWS + TRANSFORM, AngleUnits="grad"), "AngleUnits is 'grad'; expected one of deg"),
        (file(AXIS_ROWS + TRANSFORM.replace('Rz="0"', 'Rz="x"')), "Rz is 'x'"),
        (file(AXIS_ROWS + TRANSFORM.replace('Dz="4.5"', 'Dz="inf"')), "Dz is 'inf'"),
        (file(AXIS_ROWS + TRANSFORM * 2), "BasicTransform"),
        (file(AXIS_ROWS + TRANSFORM + rows("UserAxis", USER + np.eye(6)[4])), "differs"),
        (file(rows("Axis", np.zeros((6, 6)), SCALES)), "singular"),
        (file(AXIS_ROWS)[:-20], "well-formed"),
        (b"<!DOCTYPE x><FTSensor/>", "DOCTYPE"),
        (b"<FTSensor/>", "Calibration"),
    ],
)
def test_invalid_calibration_is_refused_by_name(data, reason):
    with pytest.raises(CalibrationError, match=reason):
        parse_calibration(data)


def test_refused_calibration_names_its_file(tmp_path):
    path = tmp_path / "FT9999.cal"
    path.write_bytes(file(""))
    with pytest.raises(CalibrationError, match=r"FT9999\.cal: .*neither"):
        read_calibration(path)
    with pytest.raises(CalibrationError, match=r"none\.cal cannot be read"):
        read_calibration(tmp_path / "none.cal")

    path.write_bytes(file(AXIS_ROWS + TRANSFORM))
    assert read_calibration(path).serial == "FT9999"
