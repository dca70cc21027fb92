"""Sum of base sensors that are simulated with separate rigid transforms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.control.force_fusion import FusedLoad, closure, fuse


def at_sensor(world: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Return the reading of a sensor at (0, 0, beta), rotated by alpha, for a wrench about the plate's origin."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, alpha]).as_matrix()
    pose[:3, 3] = [0.0, 0.0, beta]
    to_sensor = np.linalg.inv(pose)
    turn, (x, y, z) = to_sensor[:3, :3], to_sensor[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    adjoint = np.block([[turn, np.zeros((3, 3))], [cross @ turn, turn]])
    return adjoint @ world


@pytest.mark.parametrize("tubes", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_total_load_is_recovered_from_base_sensors_and_forces_between_tubes_cancel(tubes, seed):
    random = np.random.default_rng([tubes, seed])
    alpha, beta = random.uniform(-np.pi, np.pi, tubes), random.uniform(-0.13, 0.0, tubes)
    tip, force = random.uniform(-0.2, 0.2, 3), random.uniform(-0.5, 0.5, 3)
    load = np.r_[force, np.cross(tip, force)]
    shares = random.dirichlet(np.ones(tubes))[:, None] * load
    internal = random.normal(scale=3 * [2.0] + 3 * [0.3], size=(tubes, 6))  # friction and contact, larger than the load
    internal -= internal.mean(axis=0)  # by action and reaction the internal wrenches sum to zero
    readings = np.array([at_sensor(*each) for each in zip(shares + internal, alpha, beta, strict=True)])

    fused = fuse(readings, alpha, beta)

    np.testing.assert_allclose(fused.force, force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fused.moment, load[3:], rtol=0, atol=1e-12)
    assert closure(fused, tip) < 1e-12


def test_moment_mismatch_is_the_force_times_its_distance_from_the_tip():
    tip, force = np.array([0.0, 0.0, 0.2]), np.array([0.3, 0.0, 0.0])
    places = np.linspace(1.0, 0.0, 6)[:, None] * tip

    found = [closure(FusedLoad(force, np.cross(place, force)), tip) for place in places]

    np.testing.assert_allclose(found, 0.3 * np.array([0.0, 0.04, 0.08, 0.12, 0.16, 0.2]), rtol=0, atol=1e-12)


def test_load_along_the_line_to_the_tip_is_indistinguishable_from_a_tip_load():
    tip = np.array([0.1, 0.0, 0.2])

    assert closure(FusedLoad(0.3 * tip, np.zeros(3)), tip) < 1e-12
