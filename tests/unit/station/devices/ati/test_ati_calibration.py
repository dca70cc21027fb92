"""ATI calibration files in both forms, and the conversion of six voltages to a wrench."""

import numpy as np
import pytest

from station.devices.ati.calibration import AXES, CalibrationError, parse_calibration, read_calibration

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

    wrench = calibration.wrench(np.array([1.1, 0.8, 0.3, 0.5, 0.5, 0.5]), bias)

    # The voltages are (1, 1, 0, 0.5, 0, 1) V above the bias.
    assert wrench == pytest.approx([0.0, 2.0, 0.0, 0.011, 0.0, 0.004], abs=1e-12)
    assert calibration.wrench(bias, bias) == pytest.approx(np.zeros(6))


@pytest.mark.parametrize(("volts", "saturated"), [(9.99, False), (10.0, True), (-10.0, True), (np.nan, True)])
def test_saturated_gauge_is_detected(volts, saturated):
    calibration = parse_calibration(file(AXIS_ROWS))

    assert calibration.is_saturated(np.array([0.0, 0.0, volts, 0.0, 0.0, 0.0])) is saturated


def test_wrench_uses_the_units_of_the_calibration_file():
    metres = parse_calibration(
        file(AXIS_ROWS + TRANSFORM.replace('"4.5"', '"0.0045"'), TorqueUnits="N-mm", DistUnits="m")
    )
    pounds = parse_calibration(file(AXIS_ROWS, ForceUnits="lbf", TorqueUnits="lbf-in"))

    assert metres.matrix == pytest.approx(SI, abs=1e-12)
    assert pounds.matrix[1, 1] == pytest.approx(2.0 * 4.448222, rel=1e-6)
    assert pounds.matrix[5, 5] == pytest.approx(4.0 * 0.1129848, rel=1e-6)


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
        (file(AXIS_ROWS + TRANSFORM.replace('Rz="0"', 'Rz="90"')), "Rz is 90"),
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
