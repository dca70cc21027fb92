"""Rotations match scipy, and the closed-form fit recovers known transforms."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.rigid_transform import (
    RigidTransform,
    coil_axis,
    kabsch,
    rotation_from_vector,
    vector_from_rotation,
)
from core.errors import DescriptionError


@pytest.mark.parametrize(
    "vector",
    [(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.3, -0.2, 0.7), (0.0, 3.0, 0.5), (np.pi, 0.0, 0.0), (1e-4, 2e-4, 0.0)],
)
def test_rotations_and_their_vectors_match_scipy(vector):
    matrix = rotation_from_vector(np.array(vector))

    np.testing.assert_allclose(matrix, Rotation.from_rotvec(vector).as_matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotation_from_vector(vector_from_rotation(matrix)), matrix, rtol=0, atol=1e-9)


def test_composed_and_inverse_transforms_map_points_correctly():
    random = np.random.default_rng(0)
    first = RigidTransform(Rotation.random(rng=1).as_matrix(), random.normal(size=3))
    second = RigidTransform(Rotation.random(rng=2).as_matrix(), random.normal(size=3))
    points = random.normal(size=(5, 3))

    np.testing.assert_allclose(second.after(first).apply(points), second.apply(first.apply(points)), atol=1e-12)
    np.testing.assert_allclose(first.inverse().apply(first.apply(points)), points, atol=1e-12)


@pytest.mark.parametrize("flat", [False, True])
def test_kabsch_finds_a_known_transform_also_for_coplanar_points(flat):
    random = np.random.default_rng(3)
    points = random.normal(size=(8, 3)) * [1.0, 1.0, 0.0 if flat else 1.0]
    motion = RigidTransform(Rotation.random(rng=4).as_matrix(), random.normal(size=3))

    found = kabsch(points, motion.apply(points))

    np.testing.assert_allclose(found.rotation, motion.rotation, atol=1e-12)
    np.testing.assert_allclose(found.position, motion.position, atol=1e-12)


def test_kabsch_returns_a_proper_rotation_for_a_mirror_image():
    points = np.random.default_rng(5).normal(size=(8, 3))

    assert np.linalg.det(kabsch(points, points * [1.0, 1.0, -1.0]).rotation) == pytest.approx(1.0)


def test_kabsch_refuses_two_points():
    with pytest.raises(DescriptionError, match=r"\(2, 3\)"):
        kabsch(np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.fixture
def tips() -> Rotation:
    return Rotation.random(40, np.random.default_rng(3))


@pytest.mark.parametrize("angle", [0.0, 3.0, 40.0])
def test_a_misaligned_coil_axis_is_found_with_its_spread(tips, angle):
    true = Rotation.from_euler("zy", [70.0, angle], degrees=True).apply([0.0, 0.0, 1.0])
    noise = 0.01 * np.random.default_rng(4).standard_normal((40, 3))
    measured = (Rotation.from_rotvec(noise) * tips).apply(true)

    found = coil_axis(tips.as_matrix(), measured)

    assert np.linalg.norm(found.direction) == pytest.approx(1.0)
    assert math.acos(min(found.direction @ true, 1.0)) < 4.0 * 0.01 / math.sqrt(40)
    assert math.degrees(found.misalignment) == pytest.approx(angle, abs=0.4)
    assert found.spread == pytest.approx(0.01, rel=0.25)
    assert not found.refused


def test_a_model_that_bends_too_much_appears_as_a_misaligned_coil(tips):
    """An equal rotation of all tip frames causes no spread; only an accurate model separates it from the coil's."""
    modelled = tips * Rotation.from_euler("x", -2.0, degrees=True)

    found = coil_axis(modelled.as_matrix(), tips.apply([0.0, 0.0, 1.0]))

    assert math.degrees(found.misalignment) == pytest.approx(2.0)
    assert found.spread == pytest.approx(0.0, abs=1e-9)


def test_inconsistent_coil_axes_and_a_coil_that_points_backward_are_refused(tips):
    noise = 0.05 * np.random.default_rng(4).standard_normal((40, 3))

    found = coil_axis(tips.as_matrix(), (Rotation.from_rotvec(noise) * tips).apply([0.0, 0.0, 1.0]))

    assert "the model does not bend like the robot" in found.refused
    backward = coil_axis(tips.as_matrix(), tips.apply([0.0, 0.0, -1.0]))
    assert backward.refused.startswith("more than 45 deg: the coil is mounted backwards")
