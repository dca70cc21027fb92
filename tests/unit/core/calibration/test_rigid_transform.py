"""Rotations match scipy, and the closed-form fit recovers known transforms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.rigid_transform import RigidTransform, kabsch, rotation_from_vector, vector_from_rotation
from core.errors import DescriptionError

VECTORS = [
    np.array(vector)
    for vector in (
        [0.0, 0.0, 0.0],
        [1e-9, 0.0, 0.0],
        [0.3, -0.2, 0.7],
        [0.0, 3.0, 0.5],
        [np.pi, 0.0, 0.0],
        [1e-4, 2e-4, 0.0],
    )
]


@pytest.mark.parametrize("vector", VECTORS)
def test_rotations_and_their_vectors_match_scipy(vector):
    matrix = rotation_from_vector(vector)

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
