"""Files of measured poses: usable rows are read, unusable ones reported with their line, wrong files refused."""

import math
from pathlib import Path

import numpy as np
import pandas
import pytest
from scipy.io import savemat

from station.calibration.columns import PosesError, column_choice
from station.calibration.poses import Poses, read_poses
from station.config.robots import load_robot

HEADER = "outer_rotation,inner_rotation,inner_translation,tip_x,tip_y,tip_z"
GOOD = ("0.1,1.5,-0.1,0.01,0.02,0.2", "0.2,1.4,-0.09,0.02,0.02,0.2", "0.3,1.3,-0.08,0.03,0.02,0.2")


@pytest.fixture
def read(tmp_path):
    def read(*lines: str, robot: str = "paper", encoding: str = "utf-8") -> Poses:
        path = tmp_path / "poses.csv"
        path.write_text("\n".join(lines) + "\n", encoding=encoding)
        return read_poses(path, load_robot(robot))

    return read


def test_columns_of_a_poses_file_are_found_by_name_in_any_order_with_comments_and_spaces(read):
    found = read(
        "# made by hand", "tip_z, tip_x, tip_y, inner_translation, outer_rotation, inner_rotation",
        "0.2, 0.01, 0.02, -0.1, 0.1, 1.5", "", encoding="utf-8-sig",
    )  # fmt: skip
    (measurement,) = found.measurements
    assert measurement.joints.tolist() == [0.1, 1.5, -0.1]
    assert measurement.coil.tolist() == [0.01, 0.02, 0.2]
    assert (found.lines, found.timed, measurement.came, found.forces.tolist()) == ((3,), False, None, [[0.0, 0.0, 0.0]])


def test_forces_and_times_of_a_poses_file_are_read_and_times_give_the_order(read):
    found = read(
        f"time,{HEADER},force_x,force_y,force_z",
        "3.0,0.3,1.5,-0.10,0,0,0.2,0.1,0.2,0.3",
        "1.0,0.1,1.5,-0.12,0,0,0.2,0,0,0",
        "2.0,0.2,1.5,-0.11,0,0,0.2,0,0,0",
    )  # fmt: skip
    assert found.lines == (3, 4, 2)
    assert found.timed
    assert [measurement.came.tolist() for measurement in found.measurements] == [[0, 0, 0], [1, 0, 1], [1, 0, 1]]
    assert found.forces[-1].tolist() == [0.1, 0.2, 0.3]
    assert [measurement.weight for measurement in found.measurements] == [0.0, 0.0, None]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("nan,1.5,-0.1,0,0,0.2", ["outer_rotation", "no finite number"]),
        ("0.1,1.5,-0.1,,inf,0.2", ["tip_x, tip_y", "no finite number"]),
        ("0.1,1.5,-0.132,0,0,0.2", ["inner_translation -0.132 m", "-0.13 ... -0.005 m", "travel"]),
        ("7.1,1.5,-0.1,0,0,0.2", ["outer_rotation 7.1 rad", "6.283 rad", "travel"]),
    ],
)
def test_unusable_row_of_a_poses_file_is_left_out_and_reported_with_its_line(read, row, words):
    found = read(HEADER, *GOOD, *GOOD, row)
    assert len(found.measurements) == 6
    (left,) = found.left_out
    assert left.line == 8
    for word in words:
        assert word in left.reason


def test_pose_with_an_impossible_order_of_the_tubes_is_left_out(read):
    rows = ["0,-0.09121,0.1,-0.161,0,0.05,0.1", "0,-0.05,0.1,-0.04,0,0.05,0.1"]
    found = read("outer_rotation,outer_translation,inner_rotation,inner_translation,tip_x,tip_y,tip_z", *rows,
                 robot="nylon")  # fmt: skip
    assert len(found.measurements) == 1  # the remaining pose ends flush with the outer tube
    assert "'inner' starts at -40 mm, in front of tube 'outer' at -50 mm" in found.left_out[0].reason


def test_pose_without_a_shape_under_its_load_is_left_out(read):
    header = f"{HEADER},force_x,force_y,force_z"
    found = read(header, f"{GOOD[0]},0,0,0", f"{GOOD[1]},0,0,1e9")
    assert len(found.measurements) == 1
    assert "no shape found" in found.left_out[0].reason


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], ["empty", "tip_x"]),
        ([HEADER], ["no row"]),
        (["1,2,3,4,5,6"], ["first line contains numbers", "outer_rotation"]),
        ([HEADER.replace(",", ";"), GOOD[0]], ["separated by commas"]),
        ([HEADER.replace("inner_rotation", "inner_rot"), GOOD[0]], ["'inner_rot'", "did you mean 'inner_rotation'"]),
        ([HEADER.replace(",tip_z", ""), "0,0,-0.1,0,0"], ["no column 'tip_z'", "force_x"]),
        ([HEADER.replace("inner_rotation,", ""), "0,-0.1,0,0,0.2"], ["no column 'inner_rotation'"]),
        ([HEADER + ",force_x", "0,0,-0.1,0,0,0.2,0"], ["no column 'force_y', 'force_z'"]),
        ([HEADER + ",tip_x", GOOD[0] + ",0"], ["'tip_x' occurs 2 times"]),
        ([HEADER, GOOD[0] + ",0"], ["line 2 has 7 columns", "the header 6"]),
        ([HEADER, GOOD[0], "0,zero,-0.1,0,0,0.2"], ["line 3", "inner_rotation is 'zero'"]),
        ([HEADER, "nan,nan,nan,nan,nan,nan"], ["no row with a number in every column", "line 2"]),
        ([HEADER, "0,45,-0.1,0,0,0.2", "0,90,-0.1,0,0,0.2"], ["inner_rotation is 90 rad", "degrees", "2 of 2 rows"]),
        ([HEADER, "0,1,-100,0,0,0.2", "0,1,-90,0,0,0.2"], ["inner_translation is -100 m", "millimetres"]),
        ([HEADER, "0,1,-0.1,10,0,200", "0,1,-0.1,-90,0,250"], ["111.8 m apart", "0.303 m long", "millimetres"]),
        ([HEADER, "0,1,0.1,0,0,0.2"], ["inner_translation is 0.1 m", "outside"]),
    ],
)  # fmt: skip
def test_invalid_file_of_poses_is_refused_with_the_expected_content(read, lines, words):
    with pytest.raises(PosesError) as refused:
        read(*lines)
    for word in words:
        assert word in str(refused.value)


def test_unreadable_file_of_poses_is_refused_by_name(tmp_path):
    robot, picture = load_robot("paper"), tmp_path / "picture.csv"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(PosesError, match="not UTF-8 text"):
        read_poses(picture, robot)
    with pytest.raises(PosesError, match=r"gone\.csv: cannot be read: No such file"):
        read_poses(tmp_path / "gone.csv", robot)


def test_all_poses_of_the_measured_nylon_robot_are_read():
    found = read_poses(Path(__file__).parents[3] / "measured_nylon.csv", load_robot("nylon"))
    assert len(found.measurements) == 25
    assert found.left_out == ()
    np.testing.assert_allclose(found.measurements[0].joints, [0.0, -0.09121, -math.pi / 4.0, -0.161], atol=1e-6)


CHOICES = (
    "outer_rotation=theta_o[deg]", "inner_rotation=theta_i[deg]", "inner_translation=ins[mm]-0.15",
    "tip_x=X[mm]", "tip_y=Y[mm]", "tip_z=Z[mm]",
)  # fmt: skip
#: The same poses in degrees and millimetres; insertions count forward from 150 mm behind the plate.
TABLE = np.array([[5.0, 80.0, 50.0, 10.0, 20.0, 200.0], [6.0, 70.0, 60.0, 12.0, 22.0, 190.0]])
NAMES = ("theta_o", "theta_i", "ins", "X", "Y", "Z")


def check(found: Poses) -> None:
    """Check that the poses have the values of `TABLE`."""
    for measurement, row in zip(found.measurements, TABLE, strict=True):
        np.testing.assert_allclose(
            measurement.joints, [math.radians(row[0]), math.radians(row[1]), 1e-3 * row[2] - 0.15], atol=1e-12
        )
        np.testing.assert_allclose(measurement.coil, 1e-3 * row[3:], atol=1e-12)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("headed", [True, False])
def test_chosen_columns_of_other_tables_are_converted_to_si(tmp_path, separator, headed):
    rows = [[*map(str, row), "0.7", "note"] for row in TABLE.tolist()]
    lines = [separator.join([*NAMES, "q0", "remark"]) if headed else "# no header", *map(separator.join, rows)]
    if not headed:
        lines = [line.removesuffix(f"{separator}note") for line in lines]
    path = tmp_path / "other.txt"
    path.write_text("\n".join(lines))
    choices = CHOICES if headed else [
        choice.replace(f"={name}", f"=#{k + 1}") for k, (choice, name) in enumerate(zip(CHOICES, NAMES, strict=True))
    ]  # fmt: skip
    check(read_poses(path, load_robot("paper"), [column_choice(choice) for choice in choices]))


@pytest.mark.parametrize("kind", ["vectors", "matrix", "structure", "transforms", "rows of transforms"])
def test_matlab_files_are_read(tmp_path, kind):
    poses = np.tile(np.eye(4)[:, :, None], (1, 1, 2))
    poses[:3, 3] = TABLE[:, 3:].T
    joints = dict(zip(NAMES[:3], TABLE[:, :3].T, strict=True))
    contents, columns = {
        "vectors": (dict(zip(NAMES, TABLE.T, strict=True)) | {"note": "text", "scalar": 3.0}, NAMES),
        "matrix": ({"data": TABLE}, [f"data#{k}" for k in range(1, 7)]),
        "structure": ({"run": {"joints": TABLE[:, :3], "tip": TABLE[:, 3:]}},
                      [f"run.{part}#{k}" for part in ("joints", "tip") for k in (1, 2, 3)]),
        "transforms": (joints | {"T": poses}, [*NAMES[:3], "T#1", "T#2", "T#3"]),
        "rows of transforms": (joints | {"T": poses.transpose(2, 0, 1)}, [*NAMES[:3], "T#1", "T#2", "T#3"]),
    }[kind]  # fmt: skip
    savemat(tmp_path / "poses.mat", contents)
    choices = [
        choice.replace(f"={name}", f"={column}") for choice, name, column in zip(CHOICES, NAMES, columns, strict=True)
    ]
    check(read_poses(tmp_path / "poses.mat", load_robot("paper"), [column_choice(choice) for choice in choices]))


@pytest.mark.parametrize("headed", [True, False])
def test_first_sheet_of_an_excel_workbook_is_read(tmp_path, headed):
    columns = dict(zip(NAMES if headed else range(len(NAMES)), TABLE.T, strict=True))
    with pandas.ExcelWriter(tmp_path / "poses.xlsx") as writer:
        pandas.DataFrame(columns).to_excel(writer, sheet_name="poses", startrow=2, header=headed, index=False)
        pandas.DataFrame({"notes": ["another sheet"]}).to_excel(writer, sheet_name="notes")
    choices = CHOICES if headed else [
        choice.replace(f"={name}", f"=#{k + 1}") for k, (choice, name) in enumerate(zip(CHOICES, NAMES, strict=True))
    ]  # fmt: skip
    check(read_poses(tmp_path / "poses.xlsx", load_robot("paper"), [column_choice(choice) for choice in choices]))


@pytest.mark.parametrize(
    ("choice", "words"),
    [("tip_x", "expected NAME=COLUMN"), ("tip_x=X[inch]", "unknown unit"), ("tip_x=W", "no column 'W'")],
)
def test_a_wrong_choice_of_a_column_is_refused(tmp_path, choice, words):
    path = tmp_path / "other.csv"
    path.write_text("X,Y\n1,2\n")
    with pytest.raises(PosesError, match=words):
        read_poses(path, load_robot("paper"), [column_choice(choice)])


def test_positive_insertions_are_asked_for_and_not_guessed(read):
    with pytest.raises(PosesError, match=r"positive insertions\?.*inner_translation=-inner_translation"):
        read(HEADER, *(row.replace(",-0.", ",0.") for row in GOOD))


def test_files_that_no_library_reads_are_refused_with_advice(tmp_path):
    for name, content, words in (("a.mat", b"MATLAB 7.3 MAT-file", "-v7"), ("a.ods", b"PK", "save it as"),
                                 ("a.xlsx", b"PK", "no Excel workbook")):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        with pytest.raises(PosesError, match=words):
            read_poses(tmp_path / name, load_robot("paper"))
