"""Drawings for Foxglove, compared with the model."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.model.statics import Statics
from core.robot.robot import Base, Robot
from station.recording.drawing import Drawing, quaternion_of


def drawn(robot: Robot, channels, row, stamp: int = 3_000_000_007) -> dict[str, dict]:
    drawing = Drawing(robot, channels.all, 10)
    messages = drawing.messages(row, stamp)
    assert {message.time for message in messages} == {stamp}
    return {drawing.topics[message.topic - 10].name: json.loads(message.data) for message in messages}


def point(xyz: dict) -> list[float]:
    return [xyz["x"], xyz["y"], xyz["z"]]


def rotation(xyzw: dict) -> Rotation:
    return Rotation.from_quat([xyzw["x"], xyzw["y"], xyzw["z"], xyzw["w"]])


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_of_the_drawing_equal_their_rotation_matrices(four):
    matrix = Rotation.from_quat(four).as_matrix()

    assert Rotation.from_quat(quaternion_of(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-12)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.8)])
def test_tubes_in_the_foxglove_drawing_have_the_shape_of_the_loaded_model(paper, channels, make_rows, turn):
    plain = paper.robot()
    robot = Robot(plain.name, plain.tubes, plain.joints, Base((0.1, 0.2, 0.3), turn))
    (row,) = make_rows(1)
    found = drawn(robot, channels, row)
    solution = Statics(robot).solve(channels.of(row, "joints"), np.array([0.2, 0.0, 0.1, 0.0, 0.0, 0.0]))

    frames = {frame["child_frame_id"]: frame for frame in found["/tf"]["transforms"]}
    assert set(frames) == {"plate", "tip", "inner base", "outer base"}
    assert {frame["parent_frame_id"] for frame in frames.values()} == {"world"}
    assert point(frames["tip"]["translation"]) == pytest.approx(solution.tip, abs=1e-6)
    assert rotation(frames["tip"]["rotation"]).as_matrix() == pytest.approx(solution.rotation, abs=1e-6)
    plate = Rotation.from_rotvec(turn)
    assert point(frames["plate"]["translation"]) == [0.1, 0.2, 0.3]
    assert rotation(frames["plate"]["rotation"]).as_matrix() == pytest.approx(plate.as_matrix(), abs=1e-6)
    behind = np.array([0.1, 0.2, 0.3]) + plate.apply([0.0, 0.0, -0.1])
    assert point(frames["inner base"]["translation"]) == pytest.approx(behind, abs=1e-6)
    turned = plate * Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    assert rotation(frames["inner base"]["rotation"]).as_matrix() == pytest.approx(turned.as_matrix(), abs=1e-6)

    (entity,) = found["/scene"]["entities"]
    inner, outer = (np.array([point(p) for p in line["points"]]) for line in entity["lines"])
    assert inner[0] == pytest.approx(behind, abs=2e-6)
    assert inner[-1] == pytest.approx(solution.tip, abs=2e-6)
    for points, tube in zip((inner, outer), robot.tubes, strict=True):
        # Chords of 10 mm are shorter than a curve of at most 4/m by 1e-4.
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(tube.length, rel=1e-3)
    (arrow,) = entity["arrows"]
    along = rotation(arrow["pose"]["orientation"]).apply([1.0, 0.0, 0.0])
    assert along == pytest.approx(np.array([0.2, 0.0, 0.1]) / np.hypot(0.2, 0.1), abs=1e-6)
    assert arrow["shaft_length"] + arrow["head_length"] == pytest.approx(0.2 * np.hypot(0.2, 0.1), rel=1e-4)


def test_tip_positions_in_the_drawing_equal_the_channels_and_include_a_known_true_tip(paper, channels, make_rows):
    (row,) = make_rows(1)
    found = drawn(paper.robot(), channels, row)
    for name in ("measured", "estimated", "desired", "true"):
        pose = found[f"/tip/{name}"]
        assert point(pose["pose"]["position"]) == pytest.approx(channels.of(row, f"tip_{name}"), abs=1e-6)
        assert (pose["frame_id"], pose["timestamp"]) == ("world", {"sec": 3, "nsec": 7})

    channels.of(row, "truth_known")[:] = 0.0
    assert "/tip/true" not in drawn(paper.robot(), channels, row)


def test_the_drawing_shows_tip_positions_even_without_a_model_solution(paper, channels, make_rows):
    (row,) = make_rows(1)
    channels.of(row, "force_filtered")[:] = 1e6
    assert set(drawn(paper.robot(), channels, row)) == {"/tip/measured", "/tip/estimated", "/tip/desired", "/tip/true"}


def test_the_drawing_shows_a_force_along_minus_x_and_no_tiny_force(paper, channels, make_rows):
    (row,) = make_rows(1)
    channels.of(row, "force_filtered")[:] = (-0.1, 0.0, 0.0)
    (entity,) = drawn(paper.robot(), channels, row)["/scene"]["entities"]
    (arrow,) = entity["arrows"]
    assert rotation(arrow["pose"]["orientation"]).apply([1.0, 0.0, 0.0]) == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)

    channels.of(row, "force_filtered")[:] = (-0.001, 0.0, 0.0)
    (entity,) = drawn(paper.robot(), channels, row)["/scene"]["entities"]
    assert entity["arrows"] == []
